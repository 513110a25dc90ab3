"""Twins of demonstrations: the same motion of the same things, as the simulator's eyes see it."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from edream.core.camera import Camera
from edream.core.episode import Episode
from edream.core.errors import EdreamError
from edream.core.scene import Scene
from edream.practice.changing import tinted
from edream.practice.demonstrations import Demonstration, step_times
from edream.practice.options import PolicyOptions
from edream.practice.worlds import over
from edream.sim.camera import SimulationCamera
from edream.sim.robot import RobotModel
from edream.vision.frames import resized


def twin_images(
    episode: Episode,
    demonstration: Demonstration,
    order: Sequence[str],
    eye: SimulationCamera,
    scene: Scene,
    options: PolicyOptions,
    dressed: Callable[[], tuple[np.ndarray, np.ndarray]],
) -> np.ndarray:
    """The measured robot and the tracked things before a photo of the bench, at each control step, (T, 1, H, W, 3).

    Args:
        dressed: the background of the next step, and the factor of each colour channel of the things, (3,).

    Raises:
        EdreamError: nothing was tracked in this episode.
    """
    if not scene.at(episode.name, 0.0):
        raise EdreamError(f"render.scene has no track of any object in episode {episode.name!r}, which sft.twins needs.")
    rows = []
    for joints, time in zip(demonstration.joints, step_times(episode, options.rate), strict=True):
        seen = eye.see(dict(zip(order, joints, strict=True)), scene.at(episode.name, float(time)))
        share = np.maximum(seen.robot, seen.object)
        plate, gain = dressed()
        colour = tinted(seen.colour, seen.object, gain)
        rows.append(resized(over(plate, colour, share), options.height, options.width)[None])
    return np.stack(rows)


def twin_of(demonstration: Demonstration, images: np.ndarray, path: Path) -> Demonstration:
    """A demonstration with other images, which lie in a new file."""
    np.save(path, images)
    return replace(demonstration, name=f"{demonstration.name} (twin)", images=np.load(path, mmap_mode="r", allow_pickle=False))


def eye_of(robot: RobotModel, camera: Camera, scene: Scene, plate: np.ndarray) -> SimulationCamera:
    """The recordings' camera in the simulator, with images of the plate's size."""
    return SimulationCamera(robot, camera.resized(plate.shape[0], plate.shape[1]), scene.objects, 1)
