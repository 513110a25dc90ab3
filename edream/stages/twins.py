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
from edream.practice.changing import TwinOptions, changed_background, photos
from edream.practice.options import PolicyOptions
from edream.practice.rehearsing import plate_of
from edream.practice.sampling import demonstrations
from edream.practice.twins import eye_of, twin_images
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
    twins: TwinOptions


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

    others = photos(config.twins.folder, *plate.shape[:2])

    def one(turn: tuple[int, int], rng: np.random.Generator) -> Bundle:
        number, _ = turn

        def dressed() -> tuple[np.ndarray, np.ndarray]:
            if rng.random() >= config.twins.changed:
                return plate, np.ones(3)
            return changed_background(plate, others, rng), 1.0 + config.twins.colour * rng.standard_normal(3)

        images = twin_images(episodes[number], made[number], robot.joints, eye, scene, config.policy, dressed)
        return {"images.safetensors": {"images": images}}

    turns = [(number, copy) for number in range(len(episodes)) for copy in range(config.twins.copies)]
    try:
        shards = work.shards("episodes", turns, one, parallel=False)
    finally:
        eye.close()
    kept = {
        f"images/{n:06d}-{copy}.safetensors": shard.path("images.safetensors")
        for (n, copy), shard in zip(turns, shards, strict=True)
    }
    frames = config.twins.copies * sum(len(demonstration) for demonstration in made)
    sentence = f"{len(made)} demonstrations seen {config.twins.copies} times by the simulator, {frames} images"
    changed = f", {100 * config.twins.changed:.0f} % of them with another scene." if config.twins.changed else "."
    return {**kept, "summary.json": {"sentence": sentence + changed, "changed": config.twins.changed}}


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
    files = {"scene": scene, "plate": plate, "folder": config.twins.folder}
    return {"robot": config.robot.content()} | {name: path for name, path in files.items() if path is not None}


ENTRY = Stage("twins", 2, ("ingest", "camera"), TwinsConfig, run, sources, ("mujoco", "numpy"))
