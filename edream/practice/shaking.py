"""How training images are shaken, so that a policy does not hang on one light, one exposure or one pixel."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import UInt8

from edream.core.errors import require


@dataclass(frozen=True)
class Shake:
    """Sizes of the changes, drawn for each sample and the same in all of its views.

    Attributes:
        brightness: spread of an offset [share of full range].
        contrast: relative spread of the contrast.
        colour: relative spread of each channel's gain.
        noise: standard deviation of noise in each pixel [levels of 255].
        shift: how far an image is shifted [pixel].
    """

    brightness: float = 0.08
    contrast: float = 0.15
    colour: float = 0.08
    noise: float = 3.0
    shift: int = 1

    def __post_init__(self) -> None:
        for name in ("brightness", "contrast", "colour", "noise", "shift"):
            require(getattr(self, name) >= 0, f"sft.shake.{name}", getattr(self, name), "0 or more")


def shaken(images: UInt8[np.ndarray, "B V H W 3"], shake: Shake, rng: np.random.Generator) -> UInt8[np.ndarray, "B V H W 3"]:
    """Changed images; numbers are drawn in a fixed order, so the same generator gives the same bytes."""
    count, _, _, width, _ = images.shape
    gain = 1.0 + shake.contrast * rng.standard_normal((count, 1, 1, 1, 1), np.float32)
    tint = 1.0 + shake.colour * rng.standard_normal((count, 1, 1, 1, 3), np.float32)
    offset = 255.0 * shake.brightness * rng.standard_normal((count, 1, 1, 1, 1), np.float32)
    moves = rng.integers(-shake.shift, shake.shift + 1, (count, 2))
    values = np.empty(images.shape, np.float32)
    for i, (down, right) in enumerate(moves.tolist()):
        values[i] = _shifted(images[i], down, right)
    rows = values.reshape(count, -1, width * 3)  # long rows, in place: NumPy is slow on three numbers at a time
    rows -= 128.0
    rows *= gain[:, 0, :, 0]
    rows *= np.tile(tint[:, 0, 0], (1, 1, width))
    rows += 128.0
    rows += offset[:, 0, :, 0]
    if shake.noise:
        noise = rng.standard_normal(values.shape, np.float32)
        noise *= shake.noise
        values += noise
    np.rint(values, out=values)
    return np.clip(values, 0, 255, out=values).astype(np.uint8)


def _shifted(views: np.ndarray, down: int, right: int) -> np.ndarray:
    """Moved images whose edges are repeated, (V, H, W, 3)."""
    h, w = views.shape[1:3]
    rows, columns = np.clip(np.arange(h) - down, 0, h - 1), np.clip(np.arange(w) - right, 0, w - 1)
    return views[:, rows][:, :, columns]
