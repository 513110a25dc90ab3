"""A Frechet distance in a small fixed feature space."""

import cv2
import numpy as np
from jaxtyping import Bool, Float

from edream.core.metric import Clips, Metric
from edream.vision.features import energies, frechet


class GaborFrechet(Metric):
    """Frechet distance between Gaussians fitted to features of dreamed and of real clips.

        |m1 - m2|^2 + tr(C1 + C2 - 2 (C1 C2)^(1/2))

    A sample is a quarter of a clip's image over its whole length; its 39 features are means and spreads of the Gabor energies, and
    the energy of the second difference in time at three scales. Each feature is divided by its spread over the real clips. Not
    FVD: compare it with itself only, on the same number of clips.
    """

    name = "gabor_frechet"
    summary = "Frechet distance of 39 fixed features over quarters of clips; not FVD"
    better = "less"

    def score(self, made: Clips, real: Clips, region: Bool[np.ndarray, "N T H W"]) -> float | None:
        if len(made) < 4:
            return None
        a, b = np.concatenate([_samples(c) for c in made]), np.concatenate([_samples(c) for c in real])
        spread = b.std(axis=0) + 1e-6
        return frechet(a / spread, b / spread)


def _samples(clip: np.ndarray) -> Float[np.ndarray, "4 39"]:
    t, h, w = clip.shape[:3]
    each = np.stack([energies(clip[i]) for i in range(0, t, 3)])
    value = clip.astype(np.float32).mean(axis=3) / 255.0
    bend = value[:-2] - 2.0 * value[1:-1] + value[2:] if t > 2 else np.zeros((1, h, w), np.float32)
    rough = np.stack([[np.abs(cv2.GaussianBlur(b, (0, 0), s)) if s else np.abs(b) for s in (0, 1.0, 2.0)] for b in bend])
    rows = []
    for y in (slice(0, h // 2), slice(h // 2, h)):
        for x in (slice(0, w // 2), slice(w // 2, w)):
            some = each[:, y, x]
            rows.append(np.r_[some.mean(axis=(0, 1, 2)), some.std(axis=(0, 1, 2)), rough[:, :, y, x].mean(axis=(0, 2, 3))])
    return np.array(rows, np.float64)


ENTRY = GaborFrechet()
