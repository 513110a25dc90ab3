"""Camera: where the recordings' camera stands, from the recordings, from a file, or fitted to what it saw."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from edream.calibration.settings import RobotSettings
from edream.core.camera import Camera, as_json, from_json
from edream.core.episode import Episode
from edream.core.errors import EdreamError, unknown_name
from edream.core.stage import Artifact, Bundle, Source, Stage, Work
from edream.ingest.border import read_text
from edream.ingest.stored import stored_episodes
from edream.sim.robot import RobotModel
from edream.vision.frames import chosen_camera
from edream.vision.pose import CameraGuess, fit_to_marks, fit_to_silhouettes, read_marks
from edream.vision.views import chosen_cameras

CAMERAS = "cameras.json"
ENOUGH = 0.5  # overlap of silhouettes; found poses were right from 0.6 on, and 28 cm off at 0.31


@dataclass(frozen=True)
class CameraOptions:
    """Where the camera comes from; see `conf/camera/default.yaml` for each."""

    name: str | tuple[str, ...] | None = None
    source: Literal["auto", "recording", "file", "marks", "silhouettes"] = "auto"
    file: Path | None = None
    marks: Path | None = None
    guess: CameraGuess = CameraGuess()  # noqa: RUF009 - frozen
    frames: int = 24
    evaluations: int = 1500


@dataclass(frozen=True)
class CameraConfig:
    """What camera reads."""

    robot: RobotSettings
    camera: CameraOptions
    seed: int


def sources(config: CameraConfig) -> Mapping[str, Source]:
    """The robot with all its files, and the camera's files."""
    given = {"file": config.camera.file, "marks": config.camera.marks}
    return {"robot": config.robot.content()} | {name: path for name, path in given.items() if path is not None}


def run(inputs: Mapping[str, Artifact], config: CameraConfig, work: Work) -> Bundle:
    """Find the camera and say how sure it is."""
    options = config.camera
    episodes = [one for one in stored_episodes(inputs["ingest"]) if one.videos]
    there = tuple(episodes[0].videos) if episodes else ()
    chosen_camera(there, None)
    names = chosen_cameras(there, options.name)
    robot = config.robot.load()
    cameras, told, each = {}, [], {}
    for name in names:
        source = options.source if options.source != "auto" else _best_source(episodes, name, options)
        seed = work.seed("camera" if name == names[0] else f"camera {name}")
        cameras[name], quality = _found(source, name, episodes, robot, options, seed)
        each[name] = {"source": source, **quality}
        words = "".join(f"; {what.replace('_', ' ')} {value:.3g}" for what, value in quality.items())
        told.append(f"Camera {name!r} from {WORDS[source]}{words}.{_doubt(quality)}")
    summary = {"sentence": " ".join(told), "cameras": CAMERAS, "camera": names[0], **each[names[0]]}
    return {CAMERAS: as_json(cameras), "summary.json": summary | ({"each": each} if len(names) > 1 else {})}


WORDS = {
    "recording": "the recordings",
    "file": "a file",
    "marks": "marked points",
    "silhouettes": "the robot's silhouettes",
}


def _doubt(quality: Mapping[str, Any]) -> str:
    """A warning where what was found explains too little of what was seen."""
    if quality.get("silhouette_iou", 1.0) >= ENOUGH:
        return ""
    return " That overlap is poor, so do not trust this pose: give camera.marks or camera.file, or a better camera.guess."


def _best_source(episodes: list[Episode], name: str, options: CameraOptions) -> str:
    if options.file is not None:
        return "file"
    if options.marks is not None:
        return "marks"
    video = episodes[0].videos[name]
    return "recording" if video.intrinsics is not None and video.extrinsics is not None else "silhouettes"


def _found(
    source: str, name: str, episodes: list[Episode], robot: RobotModel, options: CameraOptions, seed: int
) -> tuple[Camera, dict[str, Any]]:
    video = episodes[0].videos[name]
    if source == "recording":
        if video.intrinsics is None or video.extrinsics is None:
            raise EdreamError(f"The recordings say nothing of where camera {name!r} stands; give camera.file or camera.marks.")
        return Camera(video.height, video.width, video.intrinsics, video.extrinsics), {}
    if source == "file":
        if options.file is None:
            raise EdreamError("camera.source=file needs camera.file=PATH, a JSON file of cameras.")
        cameras = read_cameras(options.file)
        if name not in cameras:
            raise unknown_name(f"camera in {options.file}", name, cameras)
        camera = cameras[name]
        return camera.resized(video.height, video.width), {}
    if source == "marks":
        if options.marks is None:
            raise EdreamError("camera.source=marks needs camera.marks=PATH, a CSV file of marked points.")
        return fit_to_marks(robot, episodes, name, read_marks(options.marks))
    chosen = replace(options.guess)
    return fit_to_silhouettes(robot, episodes, name, chosen, options.frames, options.evaluations, seed)


def read_cameras(path: Path) -> dict[str, Camera]:
    """Cameras by name, from JSON.

    Raises:
        EdreamError: the file is missing, is no JSON, or a camera in it cannot be read.
    """
    if not path.is_file():
        raise EdreamError(f"There is no camera file at {path}; expected JSON as {CAMERAS} of 'edream calibrate camera'.")
    try:
        return from_json(json.loads(read_text(path)), str(path))
    except (ValueError, RecursionError) as error:
        raise EdreamError(f"{path} is no JSON: {error}.") from error


ENTRY = Stage("camera", 1, ("ingest",), CameraConfig, run, sources, ("mujoco", "numpy", "scipy"))
