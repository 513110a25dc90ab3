"""Where a search begins."""

from typing import Any

import numpy as np
from jaxtyping import Float

LESS = (1.0, 0.3, 0.1, 0.03, 0.01)  # of the published dry friction


def beginning(objective: Any) -> Float[np.ndarray, "P"]:
    """The published numbers, with less dry friction on joints whose recordings are nearer to that.

    Some models are published with a friction that their servos can hardly overcome. From there every search ends in the valley of
    servos that could: all torques of a joint too large by one factor.

    Args:
        objective: an `Objective`, or what stands in its place.
    """
    space, acts = objective.simulated.space, objective.acts_on
    friction = np.array([name.startswith("coulomb.") for name in space.names])
    if not friction.any():
        return space.start()
    starts = np.array([np.where(friction, less * space.start(), space.start()) for less in LESS])
    low, high = space.from_unit(np.zeros(len(space))), space.from_unit(np.ones(len(space)))
    starts = np.clip(starts, low, high)
    squares = (objective.residuals(starts).reshape(len(LESS), -1, acts.shape[1]) ** 2).sum(axis=1)
    best = (squares @ acts.T.astype(float)).argmin(axis=0)
    return starts[best, np.arange(len(space))]
