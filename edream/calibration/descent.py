"""Gradient descent on parameters through a frozen surrogate."""

import numpy as np
import torch
from jaxtyping import Bool, Float

from edream.calibration.surrogate import Surrogate
from edream.calibration.windows import Sequences
from edream.learn.determinism import deterministic

RATE = 0.03  # of the box, falling to a tenth


def descend(
    surrogate: Surrogate,
    measured: Sequences,
    start: Float[np.ndarray, "S P"],
    prior: tuple[Float[np.ndarray, "P"], Float[np.ndarray, "P"]],
    steps: int,
    joints: Bool[np.ndarray, "J"] | None = None,
) -> tuple[Float[np.ndarray, "S P"], Float[np.ndarray, "S"]]:
    """Adam from several starts at once: least mean squared position error over the windows, plus the priors.

    Args:
        surrogate: predicts positions, differentiable in the parameters.
        measured: recorded windows.
        start: where to begin, points of the unit box.
        prior: centre of the priors, and weight of a squared distance from it.
        steps: Adam steps.
        joints: which joints count; None for all.

    Returns:
        The best point of each start and its loss.
    """
    chosen = torch.ones(measured.position.shape[2], dtype=torch.bool) if joints is None else torch.tensor(joints)
    truth = torch.tensor(measured.position, dtype=torch.float32)[:, 1:][:, :, chosen]
    centre, weight = (torch.tensor(part, dtype=torch.float32) for part in prior)
    count, size = len(start), len(measured)
    many = measured.take(np.tile(np.arange(size), count))
    with deterministic():
        point = torch.tensor(start, dtype=torch.float32).clamp(1e-3, 1 - 1e-3).logit().requires_grad_()
        adam = torch.optim.Adam([point], lr=RATE * 4)
        schedule = torch.optim.lr_scheduler.CosineAnnealingLR(adam, steps, RATE * 0.4)
        best, least = torch.tensor(start, dtype=torch.float32), torch.full((count,), torch.inf)
        for _ in range(steps):
            unit = point.sigmoid()
            predicted = surrogate.predict(unit.repeat_interleave(size, dim=0), many)[:, 1:][:, :, chosen]
            error = (predicted.reshape(count, size, *predicted.shape[1:]) - truth).square().mean(dim=(1, 2, 3))
            loss = error + (weight * (unit - centre) ** 2).sum(dim=1)
            better = loss.detach() < least
            least = torch.where(better, loss.detach(), least)
            best = torch.where(better[:, None], unit.detach(), best)
            adam.zero_grad()
            loss.sum().backward()
            adam.step()
            schedule.step()
    return best.double().numpy(), least.double().numpy()
