"""Structural similarity, as scikit-image defines it."""

import numpy as np
from jaxtyping import Bool

from edream.core.metric import Clips, Metric


class Ssim(Metric):
    """scikit-image's SSIM with Gaussian weights (sigma 1.5) on colour images; torchmetrics' differs by some 0.03."""

    name = "ssim"
    summary = "structural similarity (scikit-image, Gaussian weights), mean of the map over the region"
    better = "more"
    regional = True

    def score(self, made: Clips, real: Clips, region: Bool[np.ndarray, "N T H W"]) -> float | None:
        from skimage.metrics import structural_similarity

        total, count = 0.0, 0
        for one, other, where in zip(made, real, region, strict=True):
            for a, b, w in zip(one, other, where, strict=True):
                if w.any():
                    found = structural_similarity(
                        a, b, channel_axis=2, gaussian_weights=True, use_sample_covariance=False, data_range=255, full=True
                    )
                    table = np.asarray(found[1])
                    total, count = total + float(table[w].sum(dtype=np.float64)), count + int(w.sum()) * table.shape[2]
        return None if not count else total / count


ENTRY = Ssim()
