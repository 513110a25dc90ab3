"""Render: each recorded episode replayed in the simulator, its robot and simulated objects seen by the recording's camera."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from edream.calibration.settings import RobotSettings
from edream.core.camera import Camera, from_json
from edream.core.episode import Episode
from edream.core.errors import EdreamError
from edream.core.scene import Scene
from edream.core.stage import Artifact, Bundle, Source, Stage, Work
from edream.ingest.episode_read import read_episode
from edream.ingest.layered import layer, layered_bundle, layered_shard
from edream.ingest.stored import stored_episodes, stored_index
from edream.sim.camera import SimulationCamera, graphics
from edream.sim.meshes import lightened
from edream.sim.open_loop import open_loop
from edream.sim.robot import RobotModel
from edream.sim.window import whole
from edream.vision.frames import chosen_camera, positions_at, rows_at
from edream.vision.scene_file import read_scene
from edream.vision.views import view_name

CAMERAS = "cameras.json"
MANY = 2000  # images from which on starting further processes costs less than it saves


@dataclass(frozen=True)
class RenderOptions:
    """How the simulation is seen; see `conf/render/default.yaml` for each."""

    model: Literal["fit", "published", "none"] = "fit"
    states: Literal["replayed", "measured"] = "replayed"
    height: int = 64
    width: int = 64
    rate: float | None = 12.5
    supersampling: int = 2
    triangles: int | None = 30000
    hidden: tuple[str, ...] = ()
    scene: Path | None = None

    def __post_init__(self) -> None:
        if min(self.height, self.width) < 16 or self.height % 16 or self.width % 16:
            raise EdreamError(f"render.height and render.width are {self.height} and {self.width}; expected multiples of 16.")
        if not 1 <= self.supersampling <= 4:
            raise EdreamError(f"render.supersampling is {self.supersampling}; expected 1 to 4.")
        if self.triangles is not None and self.triangles < 1000:
            raise EdreamError(f"render.triangles is {self.triangles}; expected 1000 or more, or null for all.")


@dataclass(frozen=True)
class RenderConfig:
    """What render reads."""

    robot: RobotSettings
    render: RenderOptions


def needs(config: RenderConfig) -> tuple[str, ...]:
    """The recordings, their camera and, unless the published model is rendered, the calibrated one; for none the recordings."""
    if config.render.model == "none":
        return ("ingest",)
    replays = config.render.model == "fit" and config.render.states == "replayed"
    return ("ingest", "camera", "fit") if replays else ("ingest", "camera")


def sources(config: RenderConfig) -> Mapping[str, Source]:
    """The robot with all its files, and the scene."""
    return {"robot": config.robot.content()} | ({"scene": config.render.scene} if config.render.scene else {})


@dataclass(frozen=True, eq=False)
class Take:
    """What one process needs to render one view.

    Attributes:
        path: the file of the recording's episode.
        joints: positions to render, at the episode's times, (T, J).
        rows: images of the camera's video that are rendered.
        view: what the view is called.
        folder: for its file.
    """

    path: Path
    joints: np.ndarray
    rows: np.ndarray
    view: str
    name: str
    robot: RobotModel
    camera: Camera
    scene: Scene
    options: RenderOptions
    folder: Path


def run(inputs: Mapping[str, Artifact], config: RenderConfig, work: Work) -> Bundle:
    """Replay, then render the images nearest to a steady rate, from every camera."""
    options, robot = config.render, config.robot.load()
    if options.model == "none":
        return _video_alone(inputs["ingest"], options, work)
    cameras = from_json(inputs["camera"][CAMERAS], CAMERAS)
    scene = read_scene(options.scene)
    paths, episodes = [], []
    for row in stored_index(inputs["ingest"]):
        path = inputs["ingest"].path(f"episodes/{row.file}")
        episode = read_episode(path)
        if any(name in episode.videos for name in cameras):
            paths.append(path)
            episodes.append(episode)
    places, error = _simulated(inputs, robot, episodes, options, work)
    thinned = robot if options.triangles is None else lightened(robot, options.triangles)
    takes, views = [], {}
    folder = work.folder("writing")
    for path, episode, joints in zip(paths, episodes, places, strict=True):
        for name, native in cameras.items():
            if name in episode.videos:
                camera = _camera(episode, name, native, _from_recording(inputs["camera"], name)).resized(
                    options.height, options.width
                )
                view, rows = view_name(episode.name, name, cameras), rows_at(episode.videos[name], options.rate)
                own = folder / f"{len(takes):06d}"
                takes.append(Take(path, joints, rows, view, name, thinned, camera, scene, options, own))
                views[view] = [episode.name, name]
    with graphics():
        many = sum(len(take.rows) for take in takes) >= MANY
        bundle, told = layered_bundle(work.shards("episodes", takes, _rendered, parallel=many))
    frames = sum(t["frames"] for t in told)
    unseen = [name for name in cameras if np.mean([t["robot_share"] for t in told if views[t["view"]][1] == name]) < 1e-4]
    if unseen:
        raise EdreamError(
            f"The robot is not to be seen from camera {unseen[0]!r} in any image; its pose is wrong: check camera.file, or run "
            "'edream calibrate camera' with camera.guess."
        )
    share = float(np.mean([t["robot_share"] for t in told]))
    eyes = "" if len(cameras) == 1 else f" from {len(cameras)} cameras"
    sentence = f"{frames} images of {len(episodes)} episodes rendered{eyes}; the robot covers {100 * share:.1f} % of them."
    summary = {
        "sentence": sentence,
        "camera": next(iter(cameras)),
        "frames": frames,
        "robot_share": share,
        "states": options.states,
    }
    return bundle | {"summary.json": summary | error | ({"views": views} if len(cameras) > 1 else {})}


def _from_recording(found: Artifact, name: str) -> bool:
    """Whether a camera's pose is each episode's own, for the camera may move."""
    about = found["summary.json"]
    return about.get("each", {name: about})[name]["source"] == "recording"


def _camera(episode: Episode, name: str, common: Camera, own: bool) -> Camera:
    video = episode.videos[name]
    if not own or video.intrinsics is None or video.extrinsics is None:
        return common
    return Camera(video.height, video.width, video.intrinsics, video.extrinsics)


def _video_alone(ingested: Artifact, options: RenderOptions, work: Work) -> Bundle:
    """Recordings without a robot model: the same layers, with no robot in them."""
    episodes = [one for one in stored_episodes(ingested) if one.videos]
    name = chosen_camera(tuple(episodes[0].videos) if episodes else (), None)
    episodes = [one for one in episodes if name in one.videos]

    def one(episode: Episode, rng: np.random.Generator) -> Bundle:
        rows = rows_at(episode.videos[name], options.rate)
        blank = np.zeros((len(rows), options.height, options.width, 3), np.uint8)
        layers = {what: layer(episode.videos[name].times[rows], blank) for what in ("robot", "masks", "object")}
        about = {"frames": len(rows), "robot_share": 0.0, "rows": rows.tolist()}
        return layered_shard(episode, layers, work.folder("writing"), about)

    bundle, told = layered_bundle(work.shards("episodes", episodes, one, parallel=False))
    frames = sum(t["frames"] for t in told)
    sentence = f"{frames} images of {len(episodes)} episodes, without a robot model."
    return bundle | {"summary.json": {"sentence": sentence, "camera": name, "frames": frames, "states": "none"}}


def _simulated(
    inputs: Mapping[str, Artifact], robot: RobotModel, episodes: list[Episode], options: RenderOptions, work: Work
) -> tuple[list[np.ndarray], dict[str, Any]]:
    """Joint positions at the measured times, and how far they are from what was measured."""
    if options.states == "measured":
        return [episode.position for episode in episodes], {}
    hook = None
    if "fit" in inputs:
        fitted = inputs["fit"]
        about = fitted["summary.json"]
        robot = replace(robot, mjcf=fitted[about["model"]])
        if "hook" in about:
            hook = work.folder("hook") / "hook.py"  # what we emitted ourselves, its bytes checked by the store
            hook.write_text(fitted[about["hook"]])
    found = open_loop(robot, whole(episodes), hook)
    bad = [episode.name for episode, places in zip(episodes, found, strict=True) if not np.isfinite(places).all()]
    if bad:
        raise EdreamError(
            f"The simulation of episode {bad[0]!r} became unstable; render.states=measured renders what was measured."
        )
    errors = np.concatenate([(p - e.position) for p, e in zip(found, episodes, strict=True)])
    return found, {"replay_rmse_rad": float(np.sqrt(np.mean(errors**2)))}


def _rendered(take: Take, rng: np.random.Generator) -> Bundle:
    episode, options, size = read_episode(take.path), take.options, len(take.rows)
    times = episode.videos[take.name].times[take.rows]
    joints = positions_at(episode, take.joints, times)
    shape = (size, options.height, options.width, 3)
    robot, masks, things = np.zeros(shape, np.uint8), np.zeros(shape, np.uint8), np.zeros(shape, np.uint8)
    eye = SimulationCamera(take.robot, take.camera, take.scene.objects, options.supersampling, options.hidden)
    try:
        for i, time in enumerate(times):
            stance = dict(zip(episode.joints, joints[i], strict=True))
            frame = int(take.rows[i])
            alone = eye.see(stance, {}, frame)
            robot[i], masks[i, ..., 0] = alone.colour, alone.robot
            poses = take.scene.at(episode.name, float(time))
            if poses:
                both = eye.see(stance, poses, frame)
                things[i] = np.where(both.object[..., None] > 0, both.colour, 0)
                masks[i, ..., 1] = both.object
                masks[i, ..., 2] = both.robot
            else:
                masks[i, ..., 2] = alone.robot
    finally:
        eye.close()
    layers = {"robot": layer(times, robot), "masks": layer(times, masks), "object": layer(times, things)}
    about = {"frames": size, "robot_share": float(masks[..., 0].mean() / 255.0), "rows": take.rows.tolist(), "view": take.view}
    take.folder.mkdir(exist_ok=True)
    return layered_shard(replace(episode, name=take.view), layers, take.folder, about)


ENTRY = Stage("render", 3, needs, RenderConfig, run, sources, ("mujoco", "numpy"))
