"""Denoising in EDM's form, which is what Stable Video Diffusion's weights were trained with."""

from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import torch
from torch import Tensor

from edream.learn.objective import Network, Objective, counted_mean, draw, wide


class Edm(Objective):
    """EDM's preconditioning (Karras et al., 2022), with s the noise level and d the spread of the data:

        D(x, s) = c_skip x + c_out network(c_in x, log(s) / 4),    c_skip = d^2 / (s^2 + d^2), c_out = -s d / sqrt(s^2 + d^2)

    in the v form of SVD for d = 1; loss weighted by 1 / c_out^2. Levels are log-normal in training and follow EDM's rho schedule in
    sampling (Euler). The network's level enters as log(s) / 4, which for levels of 0.02 to 80 is about -1..1.1.

    Options: `spread` d (0.5; 1.0 for SVD), `low` 0.02, `high` 20.0, `mean` -0.4, `deviation` 1.2.
    """

    name = "edm"
    summary = "EDM preconditioning and schedule, for SVD weights"
    steps = 18

    def loss(
        self, network: Network, real: Tensor, composite: Tensor, known: Tensor, chance: torch.Generator, options: Mapping[str, Any]
    ) -> Tensor:
        b, frames = real.shape[:2]
        spread = float(options.get("spread", 0.5))
        normal = draw((b, 1), chance, real)
        level = torch.exp(float(options.get("mean", -0.4)) + float(options.get("deviation", 1.2)) * normal).expand(b, frames)
        level = torch.where(known, torch.full_like(level, 0.02), level)
        noisy = real + wide(level) * draw(tuple(real.shape), chance, real)
        weight = wide((level.square() + spread**2) / (level * spread).square())
        error = (_clean(network, noisy, level, spread) - real).square() * weight.clamp(max=1e4)
        return counted_mean(error, known)

    def sample(
        self,
        network: Network,
        composite: Tensor,
        noise: Tensor,
        steps: int,
        options: Mapping[str, Any],
        before: Tensor | None = None,
    ) -> Tensor:
        count = 0 if before is None else before.shape[1]
        low, high, spread = float(options.get("low", 0.02)), float(options.get("high", 20.0)), float(options.get("spread", 0.5))
        ramp = [i / max(steps - 1, 1) for i in range(steps)]
        levels = [(high ** (1 / 7) + r * (low ** (1 / 7) - high ** (1 / 7))) ** 7 for r in ramp] + [0.0]
        x = noise * levels[0]
        for now, then in pairwise(levels):
            level = torch.full(x.shape[:2], now, device=x.device, dtype=x.dtype)
            if before is not None:
                level[:, :count] = low
                x = torch.cat([before, x[:, count:]], dim=1)
            clean = _clean(network, x, level, spread)
            x = clean + (then / now) * (x - clean)
        return x if before is None else torch.cat([before, x[:, count:]], dim=1)


def _clean(network: Network, x: Tensor, level: Tensor, spread: float) -> Tensor:
    total = wide((level.square() + spread**2).sqrt())
    raw = network(x / total, level.log() / 4.0)
    return x * spread**2 / total.square() - wide(level) * spread / total * raw


ENTRY = Edm()
