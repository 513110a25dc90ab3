"""A background plate: the scene without robot and objects, registered from the episodes, and the sensor's noise on it."""

from collections.abc import Iterable

import numpy as np
from jaxtyping import Float, UInt8

MOST = 160  # images that are held for the median


def plate_of(
    footage: Iterable[tuple[UInt8[np.ndarray, "T H W 3"], UInt8[np.ndarray, "T H W"]]], each: int = 8
) -> UInt8[np.ndarray, "H W 3"]:
    """Median over images of many episodes in which the simulated robot does not hide the pixel.

    A median over one episode would keep an object that moves slowly; over many episodes each place is free most of the time.
    Images are first brought to one brightness, since the light wanders. Pixels that the robot always hides (its base) are taken as
    they are.

    Args:
        footage: images and the robot's share of each pixel, 0..255, an episode at a time.
        each: images taken of an episode.
    """
    images, hidden = [], []
    for real, robot in footage:
        rows = np.unique(np.linspace(0, len(real) - 1, each).astype(int))
        images += list(real[rows])
        hidden += [grown(mask > 8, 2) for mask in robot[rows]]
    keep = np.unique(np.linspace(0, len(images) - 1, min(MOST, len(images))).astype(int))
    stack = np.stack([images[i] for i in keep]).astype(np.float32)
    cover = np.stack([hidden[i] for i in keep])
    first = np.median(stack, axis=0)
    stack *= brightness(stack, first)[:, None, None, :]
    masked = np.where(cover[..., None], np.nan, stack)
    free = (~cover).sum(axis=0) >= 3
    with np.errstate(all="ignore"):
        import warnings

        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # pixels that are always hidden have no median
            middle = np.nanmedian(masked, axis=0)
    return np.clip(np.round(np.where(free[..., None], middle, np.median(stack, axis=0))), 0, 255).astype(np.uint8)


def brightness(images: Float[np.ndarray, "T H W 3"], plate: Float[np.ndarray, "H W 3"]) -> Float[np.ndarray, "T 3"]:
    """Factors that bring each image's channels to the plate's, by the median over pixels, so that moving parts do not count."""
    ratio = (plate + 4.0) / (np.asarray(images, np.float32) + 4.0)
    return np.median(ratio, axis=(1, 2))


def grown(mask: np.ndarray, pixels: int) -> np.ndarray:
    """A mask with a rim of so many pixels added."""
    import cv2

    size = 2 * pixels + 1
    return cv2.dilate(mask.astype(np.uint8), cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))) > 0
