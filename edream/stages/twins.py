"""Twins: every demonstration once more, as the simulator's eyes see it: measured robot, tracked things, photographed background."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from edream.calibration.settings import RobotSettings
from edream.core.camera import from_json
from edream.core.errors import EdreamError
from edream.core.stage import Artifact, Bundle, Source, Stage, Work
from edream.ingest.stored import stored_episodes
from edream.practice.options import PolicyOptions
from edream.practice.rehearsing import plate_of
from edream.practice.sampling import demonstrations
from edream.practice.twins import eye_of, twin_images
from edream.vision.frames import resized
from edream.vision.scene_file import read_scene


@dataclass(frozen=True)
class Tracked:
    """Where the things were."""

    scene: Path | None = None


@dataclass(frozen=True)
class Photographed:
    """The bench without robot and things."""

    plate: Path | None = None


@dataclass(frozen=True)
class TwinsConfig:
    """What twins reads."""

    robot: RobotSettings
    policy: PolicyOptions
    render: Tracked
    rollouts: Photographed


def run(inputs: Mapping[str, Artifact], config: TwinsConfig, work: Work) -> Bundle:
    """Render each episode at its control steps, from the recordings' camera."""
    tracks, photo = seen_beside(config)
    robot, scene, plate = config.robot.load(), read_scene(tracks), plate_of(photo)
    (name, camera), *_ = from_json(inputs["camera"]["cameras.json"], "cameras.json").items()
    episodes = list(stored_episodes(inputs["ingest"]))
    made, cameras, _ = demonstrations(episodes, robot.joints, config.policy, work.folder("images"))
    if cameras != (name,):
        raise EdreamError(f"sft.twins is for policies with the one camera {name!r}, not {', '.join(cameras) or 'none'}.")
    eye = eye_of(robot, camera, scene, plate)

    def one(number: int, rng: np.random.Generator) -> Bundle:
        return {"twin.safetensors": twin_images(episodes[number], made[number], robot.joints, eye, scene, config.policy, plate)}

    try:
        shards = work.shards("episodes", range(len(episodes)), one, parallel=False)
    finally:
        eye.close()
    kept = {f"twins/{number:06d}.safetensors": shard.path("twin.safetensors") for number, shard in enumerate(shards)}
    bench = resized(plate, config.policy.height, config.policy.width)
    frames = sum(len(demonstration) for demonstration in made)
    sentence = f"{len(made)} demonstrations as the simulator sees them, {frames} images."
    return {**kept, "plate.safetensors": {"plate": bench}, "summary.json": {"sentence": sentence}}


def seen_beside(config: TwinsConfig) -> tuple[Path, Path]:
    """The tracks of the things, and the photo of the empty bench.

    Raises:
        EdreamError: one of them is not given.
    """
    if config.render.scene is None or config.rollouts.plate is None:
        raise EdreamError("sft.twins needs render.scene=PATH, the tracks of the things, and rollouts.plate=PATH, the empty bench.")
    return config.render.scene, config.rollouts.plate


def sources(config: TwinsConfig) -> Mapping[str, Source]:
    scene, plate = seen_beside(config)
    return {"robot": config.robot.content(), "scene": scene, "plate": plate}


ENTRY = Stage("twins", 3, ("ingest", "camera"), TwinsConfig, run, sources, ("mujoco", "numpy"))
