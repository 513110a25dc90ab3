"""Render: each recorded episode replayed in the simulator, its robot and simulated objects seen by the recording's camera."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from edream.calibration.settings import RobotSettings
from edream.core.camera import Camera, from_json
from edream.core.episode import Episode
from edream.core.errors import EdreamError
from edream.core.scene import Scene
from edream.core.stage import Artifact, Bundle, Source, Stage, Work
from edream.ingest.layered import layer, layered_bundle, layered_shard
from edream.ingest.stored import stored_episodes
from edream.sim.camera import SimulationCamera, graphics
from edream.sim.open_loop import open_loop
from edream.sim.robot import RobotModel
from edream.sim.rollout import whole
from edream.vision.frames import chosen_camera, positions_at, rows_at
from edream.vision.scene_file import read_scene

CAMERAS, SIMULATED = "cameras.json", "simulated.json"


@dataclass(frozen=True)
class RenderOptions:
    """How the simulation is seen; see `conf/render/default.yaml` for each."""

    model: Literal["fit", "published", "none"] = "fit"
    states: Literal["replayed", "measured"] = "replayed"
    height: int = 64
    width: int = 64
    rate: float | None = 12.5
    supersampling: int = 2
    hidden: tuple[str, ...] = ()
    scene: Path | None = None

    def __post_init__(self) -> None:
        if min(self.height, self.width) < 16 or self.height % 16 or self.width % 16:
            raise EdreamError(f"render.height and render.width are {self.height} and {self.width}; expected multiples of 16.")
        if not 1 <= self.supersampling <= 4:
            raise EdreamError(f"render.supersampling is {self.supersampling}; expected 1 to 4.")


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
    """What one process needs to render one episode."""

    episode: Episode
    joints: np.ndarray
    rows: np.ndarray
    name: str
    robot: RobotModel
    camera: Camera
    scene: Scene
    options: RenderOptions


def run(inputs: Mapping[str, Artifact], config: RenderConfig, work: Work) -> Bundle:
    """Replay, then render the images nearest to a steady rate."""
    options, robot = config.render, config.robot.load()
    if options.model == "none":
        return _video_alone(inputs["ingest"], options, work)
    (name, native), *_ = from_json(inputs["camera"][CAMERAS], CAMERAS).items()
    own = inputs["camera"]["summary.json"]["source"] == "recording"  # each episode's own, for the camera may move
    scene = read_scene(options.scene)
    episodes = [one for one in stored_episodes(inputs["ingest"]) if name in one.videos]
    places, error = _simulated(inputs, robot, episodes, options, work)
    takes = [
        Take(
            episode,
            places[i],
            rows_at(episode.videos[name], options.rate),
            name,
            robot,
            _camera(episode, name, native, own).resized(options.height, options.width),
            scene,
            options,
        )
        for i, episode in enumerate(episodes)
    ]

    def one(take: Take, rng: np.random.Generator) -> Bundle:
        return _rendered(take, work.folder("writing"))

    with graphics():
        bundle, told = layered_bundle(work.shards("episodes", takes, one, parallel=False))
    frames = sum(t["frames"] for t in told)
    share = float(np.mean([t["robot_share"] for t in told]))
    if share < 1e-4:
        raise EdreamError(
            f"The robot is not to be seen from camera {name!r} in any image; its pose is wrong: check camera.file, or run "
            "'edream calibrate camera' with camera.guess."
        )
    sentence = f"{frames} images of {len(episodes)} episodes rendered; the robot covers {100 * share:.1f} % of them."
    summary = {"sentence": sentence, "camera": name, "frames": frames, "robot_share": share, "states": options.states} | error
    return bundle | {"summary.json": summary}


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
        robot = RobotModel(robot.name, fitted[about["model"]], robot.assets, robot.site)
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


def _rendered(take: Take, folder: Path) -> Bundle:
    video, options, size = take.episode.videos[take.name], take.options, len(take.rows)
    times = video.times[take.rows]
    joints = positions_at(take.episode, take.joints, times)
    shape = (size, options.height, options.width)
    robot, masks, things = np.zeros((*shape, 3), np.uint8), np.zeros((*shape, 3), np.uint8), np.zeros((*shape, 3), np.uint8)
    eye = SimulationCamera(take.robot, take.camera, take.scene.objects, options.supersampling, options.hidden)
    try:
        for i, time in enumerate(times):
            stance = dict(zip(take.episode.joints, joints[i], strict=True))
            frame = int(take.rows[i])
            alone = eye.see(stance, {}, frame)
            robot[i], masks[i, ..., 0] = alone.colour, alone.robot
            poses = take.scene.at(take.episode.name, float(time))
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
    about = {"frames": size, "robot_share": float(masks[..., 0].mean() / 255.0), "rows": take.rows.tolist()}
    return layered_shard(take.episode, layers, folder, about)


ENTRY = Stage("render", 1, needs, RenderConfig, run, sources, ("mujoco", "numpy"))
