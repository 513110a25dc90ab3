"""Flicker: how restless still pixels are, against the real video."""

import numpy as np
from jaxtyping import Bool

from edream.core.metric import Clips, Metric


class Flicker(Metric):
    """Root mean square second difference in time, a - 2 b + c, of dreamed over that of real video, on pixels outside robot and
    object.

    1 is as restless as the camera; below 1 is too smooth, above 1 flickers.
    """

    name = "flicker"
    summary = "restlessness of still pixels relative to the real video; 1 is right"
    better = "one"
    regional = True

    def score(self, made: Clips, real: Clips, region: Bool[np.ndarray, "N T H W"]) -> float | None:
        if made.shape[1] < 3:
            return None
        total = np.zeros(2)
        for one, other, where in zip(made, real, region, strict=True):
            still = where[:-2] & where[1:-1] & where[2:]
            for i, clip in enumerate((one, other)):
                value = clip.astype(np.float32)
                total[i] += float(np.square(value[:-2] - 2.0 * value[1:-1] + value[2:])[still].sum(dtype=np.float64))
        return None if not total[1] else float(np.sqrt(total[0] / total[1]))


ENTRY = Flicker()
