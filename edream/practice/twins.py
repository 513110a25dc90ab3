"""Twins of demonstrations: the same motion of the same things, as the simulator's eyes see it."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from edream.core.camera import Camera
from edream.core.episode import Episode
from edream.core.errors import EdreamError
from edream.core.scene import Scene
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
    plate: UInt8[np.ndarray, "h w 3"],
) -> dict[str, np.ndarray]:
    """The measured robot and the tracked things before a photo of the bench, at each control step.

    Returns:
        "images", (T, 1, H, W, 3); how much of each pixel robot and things "cover", and the "things" alone, (T, 1, H, W), 0..255.

    Raises:
        EdreamError: nothing was tracked in this episode.
    """
    if not scene.at(episode.name, 0.0):
        raise EdreamError(f"render.scene has no track of any object in episode {episode.name!r}, which sft.twins needs.")
    rows: dict[str, list[np.ndarray]] = {"images": [], "cover": [], "things": []}
    for joints, time in zip(demonstration.joints, step_times(episode, options.rate), strict=True):
        seen = eye.see(dict(zip(order, joints, strict=True)), scene.at(episode.name, float(time)))
        share = np.maximum(seen.robot, seen.object)
        views = {"images": over(plate, seen.colour, share), "cover": share, "things": seen.object}
        for name, view in views.items():
            rows[name].append(resized(view, options.height, options.width)[None])
    return {name: np.stack(one) for name, one in rows.items()}


def covered(demonstration: Demonstration, twin: Mapping[str, np.ndarray], path: Path) -> Demonstration:
    """A demonstration that knows where robot and things are in its images; the masks lie in a new file."""
    np.save(path, np.stack([twin["cover"], twin["things"]], axis=1))
    return replace(demonstration, masks=np.load(path, mmap_mode="r", allow_pickle=False))


def twin_of(demonstration: Demonstration, images: np.ndarray, path: Path) -> Demonstration:
    """A demonstration with other images, which lie in a new file."""
    np.save(path, images)
    return replace(demonstration, name=f"{demonstration.name} (twin)", images=np.load(path, mmap_mode="r", allow_pickle=False))


def eye_of(robot: RobotModel, camera: Camera, scene: Scene, plate: np.ndarray) -> SimulationCamera:
    """The recordings' camera in the simulator, with images of the plate's size."""
    return SimulationCamera(robot, camera.resized(plate.shape[0], plate.shape[1]), scene.objects, 1)
