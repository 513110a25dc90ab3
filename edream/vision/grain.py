"""The camera's own noise: measured in recordings where nothing moves, and put back onto images that a network made smooth."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, UInt8

BINS = 8


@dataclass(frozen=True)
class Grain:
    """Noise by brightness.

    Attributes:
        levels: standard deviation [grey levels] for pixels of brightness 0..31, 32..63, ...
    """

    levels: tuple[float, ...]

    def at(self, values: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
        """Standard deviation [grey levels] at pixel values 0..255."""
        centres = (np.arange(BINS) + 0.5) * 256 / BINS
        return np.interp(values, centres, self.levels)

    def less(self, other: "Grain") -> "Grain":
        """What is to be added to images that already have the other's noise: the root of the difference of variances."""
        return Grain(tuple(float(np.sqrt(max(a * a - b * b, 0.0))) for a, b in zip(self.levels, other.levels, strict=True)))


def measured_grain(footage: Iterable[UInt8[np.ndarray, "T H W 3"]]) -> Grain:
    """Noise of still pixels, from the second difference of three successive images: Var(a - 2 b + c) = 6 Var.

    What moves is left out: differences beyond four times the median absolute deviation within each brightness. The variance of
    rounding to whole grey levels, 1/12, is taken off, for it comes back when dreamed images are rounded.
    """
    found: list[list[np.ndarray]] = [[] for _ in range(BINS)]
    for real in footage:
        if len(real) < 3:
            continue
        value = real.astype(np.float32)
        bend = value[:-2] - 2.0 * value[1:-1] + value[2:]
        which = (real[1:-1] // (256 // BINS)).astype(int)
        for number in range(BINS):
            some = bend[which == number]
            if len(some) > 50:
                found[number].append(some[:: max(1, len(some) // 4000)])
    levels = [_spread(np.concatenate(some)) if some else np.nan for some in found]
    known = np.flatnonzero(np.isfinite(levels))
    if not len(known):
        return Grain((0.0,) * BINS)
    return Grain(tuple(float(v) for v in np.interp(np.arange(BINS), known, np.array(levels)[known])))


def _spread(bend: Float[np.ndarray, "K"]) -> float:
    size = np.abs(bend)
    still = bend[size <= 4.0 * max(1.4826 * float(np.median(size)), 1.0)]
    return float(np.sqrt(max(np.mean(np.square(still)) / 6.0 - 1.0 / 12.0, 0.0)))
