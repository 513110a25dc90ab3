"""Peak signal-to-noise ratio."""

import numpy as np
from jaxtyping import Bool

from edream.core.metric import Clips, Metric


class Psnr(Metric):
    """10 log10(255^2 / mean squared error), pooled over all pixels of all clips. Rewards the mean of what may be."""

    name = "psnr"
    summary = "peak signal-to-noise ratio, error pooled over all clips"
    unit = "dB"
    better = "more"
    regional = True

    def score(self, made: Clips, real: Clips, region: Bool[np.ndarray, "N T H W"]) -> float | None:
        total, count = 0.0, 0
        for one, other, where in zip(made, real, region, strict=True):
            error = np.square(one.astype(np.float32) - other.astype(np.float32))[where]
            total, count = total + float(error.sum(dtype=np.float64)), count + error.size
        return None if not count else float(10.0 * np.log10(255.0**2 / max(total / count, 1e-9)))


ENTRY = Psnr()
