"""A pinhole camera: where it stands in the robot's base frame and how it maps points to pixels."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from edream.core.errors import EdreamError


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole camera, static or with a pose for each frame.

        u = fx x / z + cx,    v = fy y / z + cy

    Attributes:
        height, width: size of its images [pixel].
        intrinsics: [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] [pixel]; (0, 0) is the upper left corner of the first pixel.
        pose: the camera in the robot's base frame, (4, 4), or one a frame, (T, 4, 4); x right, y down, z forward [m].
    """

    height: int
    width: int
    intrinsics: Float[np.ndarray, "3 3"]
    pose: Float[np.ndarray, "*T 4 4"]

    def __post_init__(self) -> None:
        if self.height < 1 or self.width < 1:
            raise EdreamError(f"A camera has images of {self.height} x {self.width} pixels; expected at least 1 x 1.")
        if np.shape(self.intrinsics) != (3, 3) or np.shape(self.pose)[-2:] != (4, 4):
            raise EdreamError("A camera needs intrinsics of 3 x 3 numbers and a pose of 4 x 4, or one pose for each frame.")
        if not (np.isfinite(self.intrinsics).all() and np.isfinite(self.pose).all()) or self.intrinsics[0, 0] <= 0:
            raise EdreamError("A camera's intrinsics and pose must be finite numbers with a focal length above 0.")
        rotation = self.pose[..., :3, :3]
        if not np.allclose(rotation @ np.swapaxes(rotation, -1, -2), np.eye(3), atol=1e-3) or (np.linalg.det(rotation) < 0).any():
            raise EdreamError(
                "A camera's pose has a left upper 3 x 3 block that is no rotation; expected x right, y down, z forward."
            )

    @property
    def moves(self) -> bool:
        """Whether it has a pose for each frame."""
        return self.pose.ndim == 3

    def at(self, frame: int) -> Float[np.ndarray, "4 4"]:
        """Its pose at a frame; the last one it has afterwards."""
        return self.pose[min(frame, len(self.pose) - 1)] if self.moves else self.pose

    def resized(self, height: int, width: int) -> "Camera":
        """The same view on images of another size; a change of aspect stretches them."""
        scale = np.diag([width / self.width, height / self.height, 1.0])
        return replace(self, height=height, width=width, intrinsics=scale @ self.intrinsics)

    def project(self, points: Float[np.ndarray, "N 3"], frame: int = 0) -> Float[np.ndarray, "N 2"]:
        """Pixels of points in the base frame [m]; NaN behind the camera."""
        pose = self.at(frame)
        seen = (np.asarray(points) - pose[:3, 3]) @ pose[:3, :3]
        image = seen @ self.intrinsics.T
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(seen[:, 2:] > 1e-6, image[:, :2] / image[:, 2:], np.nan)


def looking_at(
    eye: Float[np.ndarray, "3"], target: Float[np.ndarray, "3"], roll: float = 0.0, up: tuple[float, float, float] = (0.0, 0.0, 1.0)
) -> Float[np.ndarray, "4 4"]:
    """Pose of a camera at `eye` [m] that looks at `target` [m], its image's upright turned by `roll` [rad]."""
    forward = np.asarray(target, float) - np.asarray(eye, float)
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, up)
    if np.linalg.norm(right) < 1e-9:
        right = np.array([1.0, 0.0, 0.0])
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    turned = np.cos(roll) * right + np.sin(roll) * down, np.cos(roll) * down - np.sin(roll) * right
    pose = np.eye(4)
    pose[:3, :3] = np.stack([*turned, forward], axis=1)
    pose[:3, 3] = eye
    return pose


def pinhole(height: int, width: int, fovy: float, pose: Float[np.ndarray, "*T 4 4"]) -> Camera:
    """A camera with square pixels, its optical axis in the middle, and a vertical field of view [rad]."""
    focal = 0.5 * height / np.tan(0.5 * fovy)
    return Camera(height, width, np.array([[focal, 0.0, width / 2], [0.0, focal, height / 2], [0.0, 0.0, 1.0]]), pose)


def as_json(cameras: Mapping[str, Camera]) -> dict[str, Any]:
    """Cameras as JSON can say them: name -> height, width, intrinsics, extrinsics."""
    return {
        name: {"height": c.height, "width": c.width, "intrinsics": c.intrinsics.tolist(), "extrinsics": c.pose.tolist()}
        for name, c in cameras.items()
    }


def from_json(value: Any, where: str) -> dict[str, Camera]:
    """Inverse of `as_json`.

    Args:
        where: how messages name the file.

    Raises:
        EdreamError: a camera lacks something, or numbers are not what they should be.
    """
    if not isinstance(value, dict) or not value:
        raise EdreamError(f"{where} holds no cameras; expected {{name: {{height, width, intrinsics, extrinsics}}}}.")
    found = {}
    for name, one in value.items():
        try:
            matrix, pose = np.array(one["intrinsics"], float), np.array(one["extrinsics"], float)
            found[str(name)] = Camera(int(one["height"]), int(one["width"]), matrix, pose)
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            raise EdreamError(
                f"{where}: camera {name!r} is unreadable ({type(error).__name__}: {error}); expected height, width, "
                "intrinsics (3 x 3) and extrinsics (4 x 4)."
            ) from error
    return found
