"""A perceptual distance in a small fixed feature space."""

import numpy as np
from jaxtyping import Bool

from edream.core.metric import Clips, Metric, Regions
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
        return self.each(made, real, {"": region})[""]

    def each(self, made: Clips, real: Clips, where: Regions) -> dict[str, float | None]:
        apart, size = ({name: np.zeros(18) for name in where} for _ in range(2))
        for n in range(len(made)):
            for t in range(0, made.shape[1], 2):
                a, b = energies(made[n, t]), energies(real[n, t])
                for name, region in where.items():
                    w = region[n, t]
                    apart[name] += np.square(a[w] - b[w]).sum(axis=0)
                    size[name] += np.square(b[w]).sum(axis=0)
        return {
            name: float(np.sqrt(np.mean(apart[name] / np.maximum(size[name], 1e-12)))) if size[name].any() else None
            for name in where
        }


ENTRY = GaborDistance()
