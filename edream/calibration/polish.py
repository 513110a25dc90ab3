"""Gauss-Newton to the end: near on a little of the motion, then on all; priors weighed by the errors that are left."""

from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.optimize import lsq_linear

from edream.core.parameters import ParameterSpace
from edream.sim.differences import blocks, jacobian_along_axes, straight
from edream.sim.least_squares import Solution, solve, worth
from edream.sim.objective import Objective, rms
from edream.sim.rollout import Window

SETTLED = 0.8  # a noise that falls less than this any more does not change the weight of the priors
PASSES = 3
NEAR_SECONDS, NEAR_WINDOWS = 2.5, 12  # what is enough to come near
LENGTHS = (1.0, 0.5, 0.25, 0.1, 0.03)  # of a Gauss-Newton step, tried together
LITTLE = 0.1  # of a squared standard deviation: a gain that no interval would notice
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
    """The steps that an end still asks for, and the exact Jacobian there.

    Dry friction makes the loss rough: where one joint's step meets a kink, a step of all joints at once is refused for it. So each
    group of parameters that acts on joints of its own takes the length that suits those joints. Differences go along the principal
    axes of the Jacobian before; the first time, along single parameters.

    Args:
        values: where the search ended.
        iterations: most Gauss-Newton steps.
    """
    space = objective.simulated.space
    unit, residual = space.to_unit(values), objective.residuals(values)[0]
    first, scale, settled = rms(residual), worth(objective, residual), not iterations
    hessian = np.eye(len(unit))
    for number in range(iterations):
        slope = jacobian_along_axes(objective, unit, hessian, apart=True)
        moved, left = _step_by_blocks(objective, unit, residual, slope, scale)
        gained = _cost(space, unit, residual, scale) - _cost(space, moved, left, scale)
        unit, residual, hessian = moved, left, _hessian(space, slope, scale)
        settled = number > 0 and gained < LITTLE
        if settled:
            break
    slope = jacobian_along_axes(objective, unit, hessian)
    return Solution(space, space.from_unit(unit), residual, slope, settled, first, rms(residual))


def _cost(space: ParameterSpace, unit: np.ndarray, residual: np.ndarray, scale: float) -> float:
    centre, spread = space.unit_prior()
    return float(residual @ residual) / scale**2 + float((((unit - centre) / spread) ** 2).sum())


def _hessian(space: ParameterSpace, slope: np.ndarray, scale: float) -> np.ndarray:
    return slope.T @ slope / scale**2 + np.diag(space.unit_prior()[1] ** -2.0)


def _step_by_blocks(
    objective: Any, unit: np.ndarray, residual: np.ndarray, slope: np.ndarray, scale: float
) -> tuple[np.ndarray, np.ndarray]:
    """The best of the steps tried, in the unit box, and the residual there; where none is better, the start."""
    space, acts = objective.simulated.space, objective.acts_on
    centre, spread = space.unit_prior()
    rows = np.concatenate([slope / scale, np.diag(1.0 / spread)])
    wanted = -np.concatenate([residual / scale, (unit - centre) / spread])
    move = lsq_linear(rows, wanted, bounds=(-unit - 1e-12, 1.0 - unit + 1e-12)).x
    units = np.vstack([unit, straight(space, unit, np.outer(LENGTHS, move))])
    left = np.vstack([residual, objective.residuals(space.from_unit(units[1:]))])
    by_joint = (left.reshape(len(left), -1, acts.shape[1]) ** 2).sum(axis=1) / scale**2  # (length, joint)
    apart = ((units - centre) / spread) ** 2
    mixed = unit.copy()
    for own in blocks(acts):
        mixed[own] = units[(by_joint[:, acts[own].any(axis=0)].sum(axis=1) + apart[:, own].sum(axis=1)).argmin()][own]
    units, left = np.vstack([units, mixed]), np.vstack([left, objective.residuals(space.from_unit(mixed))])
    best = int(np.argmin([_cost(space, u, r, scale) for u, r in zip(units, left, strict=True)]))
    return units[best], left[best]


def short_pieces(windows: Any) -> list[Window]:
    """The first seconds of evenly chosen windows."""
    chosen = sorted(set(np.linspace(0, len(windows) - 1, min(len(windows), NEAR_WINDOWS)).round().astype(int).tolist()))
    pieces = []
    for window in (windows[i] for i in chosen):
        rows = int(np.searchsorted(window.times, NEAR_SECONDS))
        pieces.append(Window(window.episode, window.first, min(window.last, window.first + max(6, rows))))
    return pieces
