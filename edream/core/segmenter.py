"""A segmenter: how the pixels of foreground objects are found in a recording."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import UInt8

Images = UInt8[np.ndarray, "T H W 3"]
Masks = UInt8[np.ndarray, "T H W"]


@dataclass(frozen=True, eq=False)
class Footage:
    """One episode as a segmenter sees it; all images have one size.

    Attributes:
        name: of the episode.
        real: what the camera saw.
        plate: the same view without robot and objects, (H, W, 3).
        robot: share of each pixel that the simulated robot covers, 0..255.
        simulated: the same of simulated objects, 0..255; 0 where none is known.
    """

    name: str
    real: Images
    plate: UInt8[np.ndarray, "H W 3"]
    robot: Masks
    simulated: Masks


class Segmenter(ABC):
    """One way to find objects. A new one is one new file in `edream/segmenters/` that defines `ENTRY`.

    Attributes:
        options: names of its own settings, `masks.options.NAME`.
    """

    name: str
    summary: str
    options: tuple[str, ...] = ()

    @abstractmethod
    def masks(self, footage: Footage, options: Mapping[str, Any]) -> Masks:
        """Where foreground objects are to be seen, 0 or 1, without the robot.

        Raises:
            EdreamError: an option is missing or wrong.
        """
