"""Twins: every demonstration once more, as the simulator's eyes see it: measured robot, tracked things, photographed background.

Where trials take place in a diagnosed simulator the robot stands where that one has it: an encoder that counts otherwise, or from
another zero, puts it elsewhere than the published model. A fit changes no place, so its twins are those of the published robot; and
so are those of a diagnosis that puts no link elsewhere, to the last pixel, so that a policy learned from them is the same one.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from edream.calibration.settings import RobotSettings
from edream.core.camera import from_json
from edream.core.errors import EdreamError
from edream.core.stage import Artifact, Bundle, Source, Stage, Work
from edream.ingest.stored import stored_episodes
from edream.practice.options import PolicyOptions
from edream.practice.rehearsing import physics_need, physics_of, plate_of
from edream.practice.sampling import demonstrations
from edream.practice.twins import eye_of, twin_images
from edream.sim.servo import places
from edream.sim.standing import stand_alike
from edream.vision.frames import resized
from edream.vision.scene_file import read_scene


@dataclass(frozen=True)
class Tracked:
    """Where the things were."""

    scene: Path | None = None


@dataclass(frozen=True)
class Beside:
    """The bench without robot and things, and whose simulator says where the robot stands.

    Attributes:
        plate: photo of the bench.
        model: diagnose, or published for all others, so that twins are shared by these.
        physics: settings under which the diagnosis is made.
    """

    plate: Path | None = None
    model: str = "fit"
    physics: str = ""

    def __post_init__(self) -> None:
        if self.model != "diagnose":
            object.__setattr__(self, "model", "published")
            object.__setattr__(self, "physics", "")

    @property
    def needs(self) -> tuple[str, ...]:
        """The diagnosis, where it is one."""
        return (physics_need(self.model, self.physics),) if self.model == "diagnose" else ()


@dataclass(frozen=True)
class TwinsConfig:
    """What twins reads."""

    robot: RobotSettings
    policy: PolicyOptions
    render: Tracked
    rollouts: Beside


def run(inputs: Mapping[str, Artifact], config: TwinsConfig, work: Work) -> Bundle:
    """Render each episode at its control steps, from the recordings' camera."""
    tracks, photo = seen_beside(config)
    scene, plate = read_scene(tracks), plate_of(photo)
    robot = config.robot.load()
    (name, camera), *_ = from_json(inputs["camera"]["cameras.json"], "cameras.json").items()
    episodes = list(stored_episodes(inputs["ingest"]))
    made, cameras, _ = demonstrations(episodes, robot.joints, config.policy, work.folder("images"))
    if cameras != (name,):
        raise EdreamError(f"sft.twins is for policies with the one camera {name!r}, not {', '.join(cameras) or 'none'}.")
    for need in config.rollouts.needs:
        diagnosed = replace(robot, mjcf=physics_of(robot, inputs[need], work.folder("hook")).mjcf)
        readings = np.concatenate([one.joints for one in made])
        robot = robot if stand_alike(robot, diagnosed, readings) else diagnosed
    eye = eye_of(robot, camera, scene, plate)

    def one(number: int, rng: np.random.Generator) -> Bundle:
        standing = replace(made[number], joints=places(robot.model, robot.joints, made[number].joints))
        return {"twin.safetensors": twin_images(episodes[number], standing, robot.joints, eye, scene, config.policy, plate)}

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


def needs(config: TwinsConfig) -> tuple[str, ...]:
    """The recordings, their camera, and the diagnosis where that says where the robot stands."""
    return ("ingest", "camera", *config.rollouts.needs)


def sources(config: TwinsConfig) -> Mapping[str, Source]:
    scene, plate = seen_beside(config)
    return {"robot": config.robot.content(), "scene": scene, "plate": plate}


ENTRY = Stage("twins", 6, needs, TwinsConfig, run, sources, ("mujoco", "numpy"))
