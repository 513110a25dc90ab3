"""A metric: one number that says how near dreamed video is to real video."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Bool, UInt8

Clips = UInt8[np.ndarray, "N T H W 3"]
Regions = Mapping[str, Bool[np.ndarray, "N T H W"]]


class Metric(ABC):
    """One way to compare. A new one is one new file in `edream/metrics/` that defines `ENTRY`.

    Attributes:
        unit: of the number, or "".
        better: whether more or less is better, or nearer to 1.
        regional: whether it can be taken over a part of the images.
        learned: whether it needs weights, which no package ships: `score.weights.NAME`.
        about: which weights it has, for the report.
    """

    name: str
    summary: str
    unit: str = ""
    better: Literal["more", "less", "one"]
    regional: bool = False
    learned: bool = False
    about: str = ""

    def ready(self, weights: Path) -> "Metric":
        """A learned metric with its weights from a local file; others as they are.

        Raises:
            EdreamError: the file is missing, damaged, pickled, or does not fit.
        """
        return self

    @abstractmethod
    def score(self, made: Clips, real: Clips, region: Bool[np.ndarray, "N T H W"]) -> float | None:
        """The number over the pixels of a region; metrics that are not regional take whole images. None where nothing is there."""

    def each(self, made: Clips, real: Clips, where: Regions) -> dict[str, float | None]:
        """The number over each of several regions; metrics for which most of the work is the same in all of them do it once."""
        return {name: self.score(made, real, region) for name, region in where.items()}
