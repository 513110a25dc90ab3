"""Plain regression: the baseline that sampling has to beat."""

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor

from edream.learn.objective import Network, Objective, counted_mean


class Regression(Objective):
    """The network learns the residual on the composite from the composite alone, by mean squared error: the mean of what may be."""

    name = "regression"
    summary = "mean squared error from the composite, no noise, one step"
    steps = 1
    residual = True

    def loss(
        self, network: Network, real: Tensor, composite: Tensor, known: Tensor, chance: torch.Generator, options: Mapping[str, Any]
    ) -> Tensor:
        found = composite + network(composite, torch.ones(real.shape[:2], device=real.device, dtype=real.dtype))
        return counted_mean((found - real).square(), torch.zeros_like(known))

    def sample(
        self,
        network: Network,
        composite: Tensor,
        noise: Tensor,
        steps: int,
        options: Mapping[str, Any],
        before: Tensor | None = None,
    ) -> Tensor:
        found = composite + network(composite, torch.ones(composite.shape[:2], device=composite.device, dtype=composite.dtype))
        return found if before is None else torch.cat([before, found[:, before.shape[1] :]], dim=1)


ENTRY = Regression()
