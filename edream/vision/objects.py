"""The object layer without recorded pixels: a crop from a reference image, moved to where the object is."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from edream.core.camera import Camera
from edream.core.scene import SceneObject


@dataclass(frozen=True, eq=False)
class Crop:
    """An object cut from one recorded image.

    Attributes:
        colour: the whole image, (H, W, 3).
        mask: the object in it, 0 or 1, (H, W).
        corners: where its bounding box's corners were in that image [pixel], (8, 2), or None where its pose is unknown.
    """

    colour: UInt8[np.ndarray, "H W 3"]
    mask: UInt8[np.ndarray, "H W"]
    corners: Float[np.ndarray, "8 2"] | None


def corners_of(thing: SceneObject, pose: Float[np.ndarray, "7"], camera: Camera, frame: int = 0) -> Float[np.ndarray, "8 2"]:
    """Pixels of the corners of an object's bounding box."""
    half = np.array({1: thing.size * 3, 2: (thing.size[0], thing.size[0], thing.size[-1])}.get(len(thing.size), thing.size))
    w, x, y, z = pose[3:]
    turn = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    signs = np.array([[a, b, c] for a in (-1, 1) for b in (-1, 1) for c in (-1, 1)])
    return camera.project((signs * half) @ turn.T + pose[:3], frame)


def best_crop(
    images: Sequence[UInt8[np.ndarray, "H W 3"]], masks: Sequence[UInt8[np.ndarray, "H W"]], corners: Sequence[np.ndarray | None]
) -> Crop | None:
    """The crop that shows most of the object and does not touch the image's edge; None where it is never seen."""
    areas = []
    for mask in masks:
        edge = mask[0].any() or mask[-1].any() or mask[:, 0].any() or mask[:, -1].any()
        areas.append(0.0 if edge else float(mask.sum()))
    if not areas or max(areas) < 4:
        return None
    # the 80 % quantile, for the largest is often a mask that has leaked
    order = np.argsort(areas)
    seen = order[np.array(areas)[order] > 0]
    best = int(seen[int(0.8 * (len(seen) - 1))])
    return Crop(images[best], masks[best], corners[best])


def moved(
    crop: Crop, corners: Float[np.ndarray, "8 2"] | None, mask: UInt8[np.ndarray, "H W"] | None
) -> tuple[UInt8[np.ndarray, "H W 3"], UInt8[np.ndarray, "H W"]]:
    """The crop where the object is now: colour, and its share of each pixel, 0..255.

    With poses, an affine map takes the corners of the bounding box to where they are now. Without, the crop is shifted and scaled
    onto the place and size of the recorded mask: its pixels are not the target's, but its place is.
    """
    h, w = crop.mask.shape
    nothing = np.zeros((h, w, 3), np.uint8), np.zeros((h, w), np.uint8)
    if crop.corners is not None and corners is not None:
        if not np.isfinite(corners).all():
            return nothing
        source = np.concatenate([crop.corners, np.ones((8, 1))], axis=1)
        matrix = np.linalg.lstsq(source, corners, rcond=None)[0].T
    elif mask is not None and mask.any():
        now, then = _place(mask), _place(crop.mask)
        scale = np.sqrt(now[2] / then[2])
        matrix = np.array([[scale, 0, now[0] - scale * then[0]], [0, scale, now[1] - scale * then[1]]])
    else:
        return nothing
    colour = cv2.warpAffine(crop.colour, matrix, (w, h), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    share = cv2.warpAffine(crop.mask * np.uint8(255), matrix, (w, h), flags=cv2.INTER_LINEAR)
    return np.asarray(colour), np.asarray(share)


def _place(mask: np.ndarray) -> tuple[float, float, float]:
    ys, xs = np.nonzero(mask)
    return float(xs.mean()), float(ys.mean()), float(len(xs))
