"""Denoising diffusion in latent space, predicting the noise: the paper's objective."""

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor

from edream.learn.objective import Network, Objective, counted_mean, draw, uniform, wide


class Epsilon(Objective):
    """Noise prediction with a cosine schedule (Ho et al., 2020; Nichol and Dhariwal, 2021), sampled by DDIM (Song et al., 2021):

        x_t = a x + s e,    a = cos(t pi / 2), s = sin(t pi / 2),    loss |network(x_t, t) - e|^2

    The condition enters by concatenation; the network does not start from the composite. Known frames are given with little noise.
    """

    name = "epsilon"
    summary = "noise prediction from pure noise, cosine schedule, DDIM sampling"
    steps = 20

    def loss(
        self, network: Network, real: Tensor, composite: Tensor, known: Tensor, chance: torch.Generator, options: Mapping[str, Any]
    ) -> Tensor:
        b, frames = real.shape[:2]
        t = (0.001 + 0.998 * uniform((b, 1), chance, real)).expand(b, frames)
        t = torch.where(known, torch.full_like(t, 0.02), t)
        a, s = _schedule(t)
        noise = draw(tuple(real.shape), chance, real)
        return counted_mean((network(a * real + s * noise, t) - noise).square(), known)

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
        x = noise
        levels = torch.linspace(0.98, 0.0, steps + 1)
        for now, then in zip(levels[:-1].tolist(), levels[1:].tolist(), strict=True):
            t = torch.full(x.shape[:2], now, device=x.device, dtype=x.dtype)
            if before is not None:
                t[:, :count] = 0.02
                x = torch.cat([before, x[:, count:]], dim=1)
            a, s = _schedule(t)
            guess = network(x, t)
            clean = ((x - s * guess) / a).clamp(-3.0, 3.0)
            guess = (x - a * clean) / s
            later_a, later_s = _schedule(torch.full_like(t, then))
            x = later_a * clean + later_s * guess
        return x if before is None else torch.cat([before, x[:, count:]], dim=1)


def _schedule(t: Tensor) -> tuple[Tensor, Tensor]:
    return wide(torch.cos(t * torch.pi / 2)), wide(torch.sin(t * torch.pi / 2))


ENTRY = Epsilon()
