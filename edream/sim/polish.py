"""Gauss-Newton to the end: near on a little of the motion, then on all; priors weighed by the errors that are left."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.optimize import lsq_linear

from edream.sim.differences import WIDE, blocks, jacobian_along_axes, straight
from edream.sim.least_squares import Solution, solve, worth
from edream.sim.objective import Objective, rms
from edream.sim.window import Window

SETTLED = 0.8  # a noise that falls less than this any more does not change the weight of the priors
PASSES = 3
NEAR_SECONDS, NEAR_WINDOWS = 2.5, 12  # what is enough to come near
SHORTER = (0.5, 0.25, 0.1, 0.03)  # of a Gauss-Newton step, tried together where the whole one disappoints
WORD = 0.5  # share of the promised gain that a whole step must bring
COUPLED = 0.3  # of what a parameter does to its own joint; less elsewhere moves an interval by a seventh at most (arm6)
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
    """The steps that an end still asks for, and the Jacobian there.

    Dry friction makes the loss rough: where one joint's step meets a kink, a step of all joints at once is refused for it. So each
    group of parameters that acts on joints of its own takes the length that suits those joints. Differences go along the principal
    axes of the Jacobian before; the first time, along single parameters. What joints do to each other is in the Jacobian at the end
    only where it is more than a little.

    Args:
        values: where the search ended.
        iterations: most Gauss-Newton steps.
    """
    space, groups = objective.simulated.space, blocks(objective.acts_on)
    unit, residual = space.to_unit(values), objective.residuals(values)[0]
    first, scale, settled = rms(residual), worth(objective, residual), not iterations
    slope, hessian = np.zeros((len(residual), len(unit))), np.eye(len(unit))
    for number in range(iterations):
        slope = jacobian_along_axes(objective, unit, hessian, apart=True)
        hessian = slope.T @ slope / scale**2 + np.diag(space.unit_prior()[1] ** -2.0)
        before = _costs(objective, groups, unit[None], residual[None], scale).sum()
        unit, residual = _step_by_blocks(objective, groups, unit, residual, slope, scale)
        gained = before - _costs(objective, groups, unit[None], residual[None], scale).sum()
        settled = number > 0 and gained < LITTLE
        if settled:
            break
    apart = not coupled(objective, groups, unit, residual, hessian)
    if not (settled and apart and iterations):
        slope = jacobian_along_axes(objective, unit, hessian, apart)
    return Solution(space, space.from_unit(unit), residual, slope, settled, first, rms(residual))


def _costs(
    objective: Any, groups: Sequence[list[int]], units: Float[np.ndarray, "N P"], residuals: Float[np.ndarray, "N R"], scale: float
) -> Float[np.ndarray, "N B"]:
    """What each block's joints and priors cost at each of several places; joints that no block acts on cost the first one."""
    acts = objective.acts_on
    centre, spread = objective.simulated.space.unit_prior()
    joints = (residuals.reshape(len(residuals), -1, acts.shape[1]) ** 2).sum(axis=1) / scale**2
    away = ((units - centre) / spread) ** 2
    costs = np.stack([joints[:, acts[own].any(axis=0)].sum(axis=1) + away[:, own].sum(axis=1) for own in groups], axis=1)
    costs[:, 0] += joints[:, ~acts.any(axis=0)].sum(axis=1)
    return costs


def _step_by_blocks(
    objective: Any, groups: Sequence[list[int]], unit: np.ndarray, residual: np.ndarray, slope: np.ndarray, scale: float
) -> tuple[np.ndarray, np.ndarray]:
    """The whole step where it keeps its promise for every block; else the best of shorter ones, block by block; else the start."""
    space = objective.simulated.space
    centre, spread = space.unit_prior()
    rows = np.concatenate([slope / scale, np.diag(1.0 / spread)])
    wanted = -np.concatenate([residual / scale, (unit - centre) / spread])
    move = lsq_linear(rows, wanted, bounds=(-unit - 1e-12, 1.0 - unit + 1e-12)).x
    places, left = np.vstack([unit, straight(space, unit, move[None])]), residual[None]
    left = np.vstack([left, objective.residuals(space.from_unit(places[1:]))])
    costs = _costs(objective, groups, places, left, scale)
    hoped = _costs(objective, groups, (unit + move)[None], (residual + slope @ move)[None], scale)
    if np.all(costs[0] - costs[1] >= WORD * (costs[0] - hoped[0]) - LITTLE / len(groups)):
        better = int(costs[1].sum() < costs[0].sum())
        return places[better], left[better]
    shorter = straight(space, unit, np.outer(SHORTER, move))
    places, left = np.vstack([places, shorter]), np.vstack([left, objective.residuals(space.from_unit(shorter))])
    best, mixed = _costs(objective, groups, places, left, scale).argmin(axis=0), unit.copy()
    for own, number in zip(groups, best, strict=True):
        mixed[own] = places[number][own]
    places, left = np.vstack([places, mixed]), np.vstack([left, objective.residuals(space.from_unit(mixed))])
    lowest = int(_costs(objective, groups, places, left, scale).sum(axis=1).argmin())
    return places[lowest], left[lowest]


def coupled(objective: Any, groups: Sequence[list[int]], unit: np.ndarray, residual: np.ndarray, hessian: np.ndarray) -> bool:
    """Whether what a block does to the joints of others is more than `COUPLED` of what it does to its own."""
    if len(groups) == 1:
        return False
    acts, moves = objective.acts_on, np.zeros((len(groups), len(unit)))
    for number, own in enumerate(groups):
        moves[number, own] = WIDE * objective.step * np.linalg.eigh(hessian[np.ix_(own, own)])[1][:, -1]
    places = np.clip(unit + moves, 0.0, 1.0)
    moved = objective.residuals(objective.simulated.space.from_unit(places)) - residual
    joints = np.sqrt((moved.reshape(len(groups), -1, acts.shape[1]) ** 2).sum(axis=1))
    mine = np.stack([acts[own].any(axis=0) for own in groups])
    return bool(np.any(np.where(mine, 0.0, joints).max(axis=1) > COUPLED * np.where(mine, joints, 0.0).max(axis=1)))


def short_pieces(windows: Any) -> list[Window]:
    """The first seconds of evenly chosen windows."""
    chosen = sorted(set(np.linspace(0, len(windows) - 1, min(len(windows), NEAR_WINDOWS)).round().astype(int).tolist()))
    pieces = []
    for window in (windows[i] for i in chosen):
        rows = int(np.searchsorted(window.times, NEAR_SECONDS))
        pieces.append(Window(window.episode, window.first, min(window.last, window.first + max(6, rows))))
    return pieces
