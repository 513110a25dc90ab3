"""Gauss-Newton to the end: near on a little of the motion, then on all; priors weighed by the errors that are left."""

from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float

from edream.sim.least_squares import Solution, jacobian, solve, worth
from edream.sim.objective import Objective
from edream.sim.rollout import Window

SETTLED = 0.8  # a noise that falls less than this any more does not change the weight of the priors
PASSES = 3
NEAR_SECONDS, NEAR_WINDOWS = 2.5, 12  # what is enough to come near
WORTHWHILE = 0.34  # of the motion; with more in the near windows, the search begins on all


def polish(
    objective: Objective,
    start: Float[np.ndarray, "P"] | None,
    iterations: int,
    tolerance: float = 1e-4,
    secant: bool = False,
    cheap: bool = False,
) -> Solution:
    """Solve, and again with the noise that was found, until it settles.

    A prior that is weighed by the errors of a bad start pulls a hundred times too hard.

    Args:
        iterations: most Gauss-Newton steps in each pass.
        secant, cheap: simulate fewer Jacobians; see `edream.sim.least_squares.solve`.
    """
    noise, slope = None, None
    for number in range(PASSES):
        solution = solve(objective, start, noise, iterations, tolerance, secant, cheap, slope)
        left = worth(objective, solution.residual)
        if (noise is not None and left > SETTLED * noise) or number == PASSES - 1:
            break
        start, noise = solution.values, left
        slope = solution.jacobian if secant else None
    return solution


def polish_in_stages(
    objective: Any, start: Float[np.ndarray, "P"] | None, near_iterations: int, iterations: int
) -> tuple[Solution, int]:
    """Come near on short pieces of some windows, finish on all windows, both with cheap Jacobians; `finish` sees to the rest.

    Args:
        objective: an `Objective`, or what stands in its place.
        near_iterations: most Gauss-Newton steps in each pass on the short pieces.
        iterations: most Gauss-Newton steps on all windows.

    Returns:
        The solution on all windows, and how many windows the short pieces amount to; the objective counts its own.
    """
    windows = short_pieces(objective.windows)
    share = sum(w.times[-1] for w in windows) / sum(w.times[-1] for w in objective.windows)
    if share > WORTHWHILE:
        return polish(objective, start, near_iterations, secant=True, cheap=True), 0
    few = replace(objective, windows=windows, simulations=0)
    near = polish(few, start, near_iterations, tolerance=1e-2, secant=True, cheap=True)
    # its errors are those that will be left, so they weigh the priors rightly at once
    solution = solve(objective, near.values, iterations=iterations, tolerance=1e-3, secant=True, cheap=True)
    return solution, round(few.simulations * share * len(objective.windows) / len(windows))


def finish(objective: Any, values: Float[np.ndarray, "P"], iterations: int) -> Solution:
    """The exact Jacobian at a solution, and the steps that it still asks for: one where cheap Jacobians led to the right place.

    Args:
        values: where the search ended.
        iterations: most Gauss-Newton steps.
    """
    residual = objective.residuals(values)[0]
    space = objective.simulated.space
    slope = jacobian(objective, space, space.to_unit(values), residual)
    return solve(objective, values, worth(objective, residual), iterations, tolerance=1e-3, secant=True, slope=slope)


def short_pieces(windows: Any) -> list[Window]:
    """The first seconds of evenly chosen windows."""
    chosen = sorted(set(np.linspace(0, len(windows) - 1, min(len(windows), NEAR_WINDOWS)).round().astype(int).tolist()))
    pieces = []
    for window in (windows[i] for i in chosen):
        rows = int(np.searchsorted(window.times, NEAR_SECONDS))
        pieces.append(Window(window.episode, window.first, min(window.last, window.first + max(6, rows))))
    return pieces
