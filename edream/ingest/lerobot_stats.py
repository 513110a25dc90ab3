"""Minimum, maximum, mean and deviation of each feature, as LeRobot keeps them an episode and over all."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float

from edream.core.episode import Video

SAMPLE_IMAGES, SAMPLE_STEP = 100, 4


@dataclass
class _Sums:
    low: np.ndarray
    high: np.ndarray
    total: np.ndarray
    squares: np.ndarray
    pixels: int
    rows: int

    def values(self) -> dict[str, Any]:
        mean = self.total / self.pixels
        spread = np.sqrt(np.maximum(self.squares / self.pixels - mean**2, 0.0))
        parts = {"min": self.low, "max": self.high, "mean": mean, "std": spread}
        return {name: part.tolist() for name, part in parts.items()} | {"count": [self.rows]}


@dataclass
class Stats:
    """Running statistics of features; images are (3, 1, 1) in 0..1, as the client expects."""

    sums: dict[str, _Sums] = field(default_factory=dict)

    def add(self, key: str, values: Float[np.ndarray, "T C"]) -> None:
        """Take the rows of one feature in."""
        self._take(key, _Sums(values.min(0), values.max(0), values.sum(0), (values**2).sum(0), len(values), len(values)))

    def add_images(self, key: str, images: Float[np.ndarray, "N H W 3"]) -> None:
        """Take images in, in 0..1."""
        low, high = (edge(images, axis=(0, 1, 2)).reshape(3, 1, 1) for edge in (np.min, np.max))
        total, squares = (part.sum(axis=(0, 1, 2)).reshape(3, 1, 1) for part in (images, images**2))
        self._take(key, _Sums(low, high, total, squares, images.size // 3, len(images)))

    def merge(self, other: "Stats") -> None:
        """Take another's sums in."""
        for key, sums in other.sums.items():
            self._take(key, sums)

    def _take(self, key: str, new: _Sums) -> None:
        old = self.sums.get(key)
        self.sums[key] = (
            new
            if old is None
            else _Sums(
                np.minimum(old.low, new.low),
                np.maximum(old.high, new.high),
                old.total + new.total,
                old.squares + new.squares,
                old.pixels + new.pixels,
                old.rows + new.rows,
            )
        )

    def nested(self) -> dict[str, dict[str, Any]]:
        """feature -> statistic -> value, as in `meta/stats.json`."""
        return {key: sums.values() for key, sums in self.sums.items()}

    def flat(self) -> dict[str, Any]:
        """`stats/FEATURE/STATISTIC` -> value, as in `meta/episodes`."""
        return {f"stats/{key}/{name}": value for key, sums in self.sums.items() for name, value in sums.values().items()}


def image_sample(video: Video) -> Float[np.ndarray, "N H W 3"]:
    """Up to 100 evenly spread images of a video, every fourth pixel, in 0..1."""
    every = max(1, len(video.times) // SAMPLE_IMAGES)
    kept = [image[::SAMPLE_STEP, ::SAMPLE_STEP] for row, image in enumerate(video.frames()) if row % every == 0]
    return np.stack(kept) / 255.0
