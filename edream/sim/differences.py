"""Jacobians by differences of simulations, all of one Jacobian in one batch."""

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float

from edream.core.parameters import ParameterSpace
from edream.sim.objective import Objective

WIDE = 3.0  # steps, to either side: where kinks matter more than curvature, at the end of a fit
FAR = 30.0  # steps: the longest difference along a direction that hardly shows
FINE = 3e-4  # of the unit box: for a robot that moves otherwise within a step
STRAIGHT = 0.985  # the cosine between what a step forwards and one backwards do, from which they are one slope


def with_straight_step(objective: Objective, unit: Float[np.ndarray, "P"]) -> Objective:
    """The objective with fine differences where its usual ones are no slope: forwards they say other than backwards.

    Servos that give all they have one way or the other turn over at moments that move with every number, and what a joint does
    after one bends within a usual step. Those that keep within their limits have cosines of 0.998 and more in the median.
    """
    space, acts = objective.simulated.space, objective.acts_on
    base = objective.residuals(space.from_unit(unit))[0]
    ahead, behind = (nearly(objective, space, unit, base, side) for side in (1.0, -1.0))
    inside = (unit >= objective.step) & (unit <= 1.0 - objective.step) & acts.any(axis=1)
    length = np.linalg.norm(ahead, axis=0) * np.linalg.norm(behind, axis=0)
    cosines = ((ahead * behind).sum(axis=0) / np.maximum(length, 1e-300))[inside & (length > 0.0)]
    bends = bool(cosines.size) and float(np.median(cosines)) < STRAIGHT
    return replace(objective, step=FINE) if bends else objective


def jacobian(
    objective: Objective, space: ParameterSpace, unit: Float[np.ndarray, "P"], base: Float[np.ndarray, "R"]
) -> Float[np.ndarray, "R P"]:
    """Forward differences in the unit box, each towards the inside, all simulated in one batch."""
    steps = inwards(objective, unit)
    moved = objective.residuals(space.from_unit(unit + np.diag(steps)))
    return ((moved - base) / steps[:, None]).T


def inwards(objective: Objective, unit: Float[np.ndarray, "P"], side: float = 1.0) -> Float[np.ndarray, "P"]:
    """How far each parameter is moved for a difference: the objective's step to the one side, or to the other where that is out."""
    step = side * objective.step
    return np.where((unit + step >= 0.0) & (unit + step <= 1.0), step, -step)


def nearly(
    objective: Objective,
    space: ParameterSpace,
    unit: Float[np.ndarray, "P"],
    base: Float[np.ndarray, "R"],
    side: float = 1.0,
) -> Float[np.ndarray, "R P"]:
    """The Jacobian as if a parameter of one joint moved that joint alone: those of different joints share a simulation.

    With four parameters on each of six joints that takes 4 simulations instead of 24. What joints do to each other is left to
    Broyden's updates; near a solution with small residuals the fit ends at the same place.
    Source: Curtis, Powell, Reid, J. Inst. Maths Applics 13, 1974, for columns that share no rows.
    """
    acts = objective.acts_on
    groups = sharing(acts)
    steps = inwards(objective, unit, side)
    moves = np.array([np.where(np.isin(np.arange(len(unit)), group), steps, 0.0) for group in groups])
    moved = objective.residuals(space.from_unit(unit + moves)) - base
    slope = np.zeros((len(base), len(unit)))
    for difference, group in zip(moved, groups, strict=True):
        rows = difference.reshape(-1, acts.shape[1])
        for p in group:
            slope[:, p] = np.where(acts[p], rows / steps[p], 0.0).ravel()
    return slope


def sharing(acts: Bool[np.ndarray, "P J"]) -> list[list[int]]:
    """Parameters dealt into as few groups as comes easily, so that no two of a group act on the same joint."""
    groups: list[tuple[list[int], np.ndarray]] = []
    for p, joints in enumerate(acts):
        free = next((group for group in groups if not (group[1] & joints).any()), None)
        if free is None:
            free = ([], np.zeros(acts.shape[1], bool))
            groups.append(free)
        free[0].append(p)
        free[1][:] |= joints
    return [members for members, _ in groups]


def blocks(acts: Bool[np.ndarray, "P J"]) -> list[list[int]]:
    """Parameters in groups that act on joints of their own."""
    found: list[tuple[list[int], np.ndarray]] = []
    for number, joints in enumerate(acts):
        touching = [block for block in found if (block[1] & joints).any()]
        merged = ([*(n for block in touching for n in block[0]), number], np.any([joints, *(b[1] for b in touching)], axis=0))
        found = [block for block in found if not (block[1] & joints).any()] + [merged]
    return [sorted(numbers) for numbers, _ in found]


def jacobian_along_axes(
    objective: Objective, unit: Float[np.ndarray, "P"], hessian: Float[np.ndarray, "P P"], apart: bool = False
) -> Float[np.ndarray, "R P"]:
    """Central differences along the principal axes of a Hessian, longer ones where it is flat.

    A joint whose torques are all larger by one factor moves almost as before. Along such a valley the differences of single
    parameters cancel, and what the kinks of dry friction leave of them passes for a slope: the valley seems steep, steps in it come
    out too short and intervals too narrow. One long difference along the valley sees how flat it is.

    Args:
        hessian: of the cost in the unit box, from an earlier Jacobian and the priors; where it is the identity, each parameter is
            moved by itself.
        apart: as if a parameter moved only the joints it acts on, so that blocks of parameters share simulations.
    """
    space, acts = objective.simulated.space, objective.acts_on
    groups = blocks(acts) if apart else [list(range(len(unit)))]
    most = max(len(group) for group in groups)
    ends = np.repeat(unit[None, None], 2, axis=0).repeat(most, axis=1)  # (side, axis, parameter)
    for group in groups:
        curvature, axes = np.linalg.eigh(hessian[np.ix_(group, group)])
        curvature = np.maximum(curvature, 1e-12 * curvature[-1])
        reach = objective.step * np.clip(WIDE * np.sqrt(np.median(curvature) / curvature), WIDE, FAR)
        moves = np.zeros((len(group), len(unit)))
        moves[:, group] = (axes * reach).T
        for side, sign in enumerate((1.0, -1.0)):
            ends[side, : len(group), group] = straight(space, unit, sign * moves)[:, group].T
    residuals = objective.residuals(space.from_unit(ends.reshape(-1, len(unit)))).reshape(2, most, -1)
    across, change = ends[0] - ends[1], residuals[0] - residuals[1]
    slope = np.zeros((change.shape[1], len(unit)))
    for group in groups:
        count = len(group)
        own = np.linalg.lstsq(across[:count, group], change[:count], rcond=None)[0]  # (parameter, row)
        if apart:
            rows = own.reshape(count, -1, acts.shape[1])
            own = np.where(acts[group].any(axis=0), rows, 0.0).reshape(count, -1)
        slope[:, group] = own.T
    return slope


def straight(space: ParameterSpace, unit: Float[np.ndarray, "P"], moves: Float[np.ndarray, "N P"]) -> Float[np.ndarray, "N P"]:
    """Where moves in the unit box lead when they go straight in the parameters' own units, kept in the box.

    Gains searched by their ratio and frictions searched as they are grow together along a straight line only there.
    """
    small = 1e-4
    inside = np.clip(unit, small, 1.0 - small)
    pace = (space.from_unit(inside + small) - space.from_unit(inside - small)) / (2.0 * small)
    low, high = (space.from_unit(np.full(len(unit), side)) for side in (0.0, 1.0))
    return np.clip(space.to_unit(np.clip(space.from_unit(unit) + moves * pace, low, high)), 0.0, 1.0)
