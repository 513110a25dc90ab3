"""Gauss-Newton to the end: the weight of the priors follows the errors that are left, not those of the start."""

import numpy as np
from jaxtyping import Float

from edream.sim.least_squares import Solution, solve, worth
from edream.sim.objective import Objective

SETTLED = 0.8  # a noise that falls less than this any more does not change the weight of the priors
PASSES = 3


def polish(objective: Objective, start: Float[np.ndarray, "P"] | None, iterations: int, tolerance: float = 1e-4) -> Solution:
    """Solve, and again with the noise that was found, until it settles.

    A prior that is weighed by the errors of a bad start pulls a hundred times too hard.

    Args:
        iterations: most Gauss-Newton steps in each pass.
    """
    noise = None
    for number in range(PASSES):
        solution = solve(objective, start, noise=noise, iterations=iterations, tolerance=tolerance)
        left = worth(objective, solution.residual)
        if (noise is not None and left > SETTLED * noise) or number == PASSES - 1:
            break
        start, noise = solution.values, left
    return solution
