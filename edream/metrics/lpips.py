"""LPIPS, where its weights are at hand."""

from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool

from edream.core.metric import Clips, Metric
from edream.learn.lpips import Lpips, distances, read_lpips

AT_ONCE = 16  # images


class LearnedDistance(Metric):
    """LPIPS version 0.1 on AlexNet or VGG16, mean over images; over a region the mean of its map upsampled to pixels.

    `score.weights.lpips` names a .safetensors file with the backbone's features and the five heads; without it, it is not computed.
    """

    name = "lpips"
    summary = "LPIPS 0.1 on AlexNet or VGG16, weights from score.weights.lpips"
    better = "less"
    regional = True
    learned = True

    def __init__(self, network: Lpips | None = None) -> None:
        self.network = network
        self.about = "" if network is None else f"LPIPS 0.1 on {network.backbone}"

    def ready(self, weights: Path) -> "LearnedDistance":
        return LearnedDistance(read_lpips(weights))

    def score(self, made: Clips, real: Clips, region: Bool[np.ndarray, "N T H W"]) -> float | None:
        if self.network is None or not region.any():
            return None
        device = "cuda" if torch.cuda.is_available() else "cpu"
        network, whole = self.network.to(device), bool(region.all())
        total = count = 0.0
        for one, other, where in zip(made, real, region, strict=True):
            for first in range(0, len(one), AT_ONCE):
                rows = slice(first, first + AT_ONCE)
                each, table = distances(network, *(_images(clip[rows]).to(device) for clip in (one, other)))
                if whole:
                    total, count = total + float(each.sum()), count + len(each)
                else:
                    total += float(table.double().cpu().numpy()[where[rows]].sum())
                    count += float(where[rows].sum())
        return total / count if count else None


def _images(clip: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(np.ascontiguousarray(clip)).movedim(-1, 1).float() / 127.5 - 1.0


ENTRY = LearnedDistance()
