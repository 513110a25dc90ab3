"""No objects: the ablation without segmentation."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from edream.core.segmenter import Footage, Masks, Segmenter


class Nothing(Segmenter):
    """Finds nothing; the condition is the robot alone."""

    name = "none"
    summary = "no object is ever found"

    def masks(self, footage: Footage, options: Mapping[str, Any]) -> Masks:
        return np.zeros_like(footage.robot)


ENTRY = Nothing()
