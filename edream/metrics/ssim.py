"""Structural similarity, as scikit-image defines it."""

import numpy as np
from jaxtyping import Bool, Float, UInt8

from edream.core.metric import Clips, Metric, Regions


class Ssim(Metric):
    """scikit-image's SSIM with Gaussian weights (sigma 1.5) on colour images; torchmetrics' differs by some 0.03."""

    name = "ssim"
    summary = "structural similarity (scikit-image, Gaussian weights), mean of the map over the region"
    better = "more"
    regional = True

    def score(self, made: Clips, real: Clips, region: Bool[np.ndarray, "N T H W"]) -> float | None:
        return self.each(made, real, {"": region})[""]

    def each(self, made: Clips, real: Clips, where: Regions) -> dict[str, float | None]:
        total, count = dict.fromkeys(where, 0.0), dict.fromkeys(where, 0)
        for n, t in np.ndindex(made.shape[:2]):
            table = _map(made[n, t], real[n, t])
            for name, region in where.items():
                total[name] += float(table[region[n, t]].sum(dtype=np.float64))
                count[name] += int(region[n, t].sum()) * table.shape[2]
        return {name: total[name] / count[name] if count[name] else None for name in where}


def _map(a: UInt8[np.ndarray, "H W 3"], b: UInt8[np.ndarray, "H W 3"]) -> Float[np.ndarray, "H W 3"]:
    from skimage.metrics import structural_similarity

    options = {"channel_axis": 2, "gaussian_weights": True, "use_sample_covariance": False, "data_range": 255}
    return np.asarray(structural_similarity(a, b, full=True, **options)[1])


ENTRY = Ssim()
