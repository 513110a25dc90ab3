"""FVD, where I3D's weights are at hand."""

from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool

from edream.core.metric import Clips, Metric
from edream.learn.i3d import SHORTEST, I3d, features, read_i3d
from edream.vision.features import frechet


class VideoDistance(Metric):
    """Frechet distance between Gaussians fitted to I3D's logits of dreamed and of real clips (Unterthiner et al., 2018).

    Clips are brought to 224 x 224 (bilinear); the distance is taken by eigenvalues in double precision. It needs clips of ten
    images or more. It falls with the number of clips: compare it at equal numbers and lengths only, which the report prints.
    `score.weights.fvd` names the .safetensors file; without it, it is not computed.
    """

    name = "fvd"
    summary = "Frechet video distance on I3D's logits, weights from score.weights.fvd"
    better = "less"
    learned = True

    def __init__(self, network: I3d | None = None) -> None:
        self.network = network
        self.about = "" if network is None else "FVD on I3D's logits (Kinetics-400, 224 x 224)"
        self._last: tuple[Clips, np.ndarray] | None = None

    def ready(self, weights: Path) -> "VideoDistance":
        return VideoDistance(read_i3d(weights))

    def score(self, made: Clips, real: Clips, region: Bool[np.ndarray, "N T H W"]) -> float | None:
        if self.network is None or len(made) < 2 or made.shape[1] < SHORTEST:
            return None
        if self._last is None or self._last[0] is not real:  # every row is compared with the same real clips
            self._last = real, _features(self.network, real)
        return frechet(_features(self.network, made), self._last[1], 0.0)


def _features(network: I3d, clips: Clips) -> np.ndarray:
    device = "cuda" if torch.cuda.is_available() else "cpu"
    network.to(device)
    rows = []
    for clip in clips:
        images = torch.from_numpy(np.ascontiguousarray(clip)).movedim(-1, 1).float() / 127.5 - 1.0
        rows.append(features(network, images.to(device)).double().cpu().numpy())
    return np.stack(rows)


ENTRY = VideoDistance()
