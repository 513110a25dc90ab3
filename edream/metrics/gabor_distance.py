"""A perceptual distance in a small fixed feature space."""

import numpy as np
from jaxtyping import Bool

from edream.core.metric import Clips, Metric
from edream.vision.features import energies


class GaborDistance(Metric):
    """Root mean square difference of Gabor energies and blurred colours (`edream.vision.features`), relative to their mean size.

    In the spirit of LPIPS, but with 18 filters that are written down rather than learned: compare it with itself only. It counts
    missing texture and blur, which PSNR forgives.
    """

    name = "gabor_distance"
    summary = "relative difference of 18 fixed Gabor energies; not LPIPS"
    better = "less"
    regional = True

    def score(self, made: Clips, real: Clips, region: Bool[np.ndarray, "N T H W"]) -> float | None:
        apart, size, count = np.zeros(18), np.zeros(18), 0
        for one, other, where in zip(made, real, region, strict=True):
            for t in range(0, len(one), 2):
                w = where[t]
                if w.any():
                    a, b = energies(one[t])[w], energies(other[t])[w]
                    apart += np.square(a - b).sum(axis=0)
                    size += np.square(b).sum(axis=0)
                    count += len(a)
        return None if not count else float(np.sqrt(np.mean(apart / np.maximum(size, 1e-12))))


ENTRY = GaborDistance()
