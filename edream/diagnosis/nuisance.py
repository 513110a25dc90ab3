"""The first fit: what every real robot has, found before anything is called missing."""

from dataclasses import replace

import numpy as np

from edream.diagnosis.descent import Fit, begin, descend
from edream.diagnosis.left_out import leaves_no_gap
from edream.diagnosis.problem import CREDIBLE_FACTOR, VISIBLE, Problem, nuisance_placements
from edream.sim.beginning import beginning
from edream.sim.differences import with_straight_step
from edream.sim.least_squares import worth
from edream.sim.objective import Objective, rms
from edream.sim.polish import finish, polish_in_stages
from edream.sim.servo import share_within_limit
from edream.sim.simulation import SimulatedRobot

NEAR, PASS, LAST = 12, 10, 4  # most steps on short pieces, on whole motions, joint by joint
SHARE = 0.5  # standard deviations by which a share is moved to see whether motions tell it
FAR = 4.0  # floors of error from which a valley with incredible numbers may be the wrong one


def published(problem: Problem) -> Objective:
    """The published model as it stands, on the fitted motions."""
    return Objective(
        SimulatedRobot(problem.robot, ()), problem.fitted, problem.counted, problem.settings.stride, problem.settings.threads
    )


def fit_nuisance(problem: Problem) -> Fit:
    """Gain, damping, dry friction and inertia of every group of joints, first without priors, then with those that are credible."""
    bare = SimulatedRobot(problem.robot, nuisance_placements(problem))
    objective = replace(published(problem), simulated=bare)
    start = bare.space.to_unit(beginning(objective))
    objective = with_straight_step(objective, np.clip(start, 0.0, 1.0))
    first = descend(begin(objective, start), None, iterations=8, tolerance=0.01)
    if not leaves_no_gap(problem, first):  # numbers that sank may have sunk by mistake
        first = raised(first)
    if first.rms > FAR * problem.floor and not credible(first):
        first = min(first, calibrated(objective), key=lambda one: one.rms)
    believed = SimulatedRobot(problem.robot, nuisance_placements(problem, bare.space.mapping(first.values)))
    unit = believed.space.to_unit(first.values)
    again = with_straight_step(replace(published(problem), simulated=believed), np.clip(unit, 0.0, 1.0))
    started = replace(
        first, objective=again, unit=unit, jacobian=_rescaled(first, believed), scale=worth(again, first.residual), ended=False
    )
    return descend(started, None, iterations=4, tolerance=0.003)


def with_shares(problem: Problem, fit: Fit) -> tuple[Problem, Fit]:
    """The problem and its fit, the servo's share of a joint's damping a number of its own wherever the motions tell it.

    What the servo damps counts towards the limit of its torque, what the joint damps does not. Only motions that reach the limit
    tell the two apart: there half the share's usual spread moves the robot by what can be seen.
    """
    if "viscous" not in problem.settings.nuisance:
        return problem, fit
    model, found = problem.robot.model, fit.space.mapping(fit.values)
    limited = tuple(group for group in problem.groups if all(share_within_limit(model, joint) > 0.0 for joint in group))
    wide = SimulatedRobot(problem.robot, nuisance_placements(replace(problem, shared=limited), found))
    space, objective = wide.space, replace(fit.objective, simulated=wide, simulations=0)
    shares = [p for p in space.parameters if p.name not in found]
    sets = [[(found | {p.name: p.start - SHARE * p.spread}).get(q.name, q.start) for q in space.parameters] for p in shares]
    away = objective.residuals(np.array(sets)) - fit.residual if shares else []
    told = tuple(group for group, one in zip(limited, away, strict=True) if rms(one) > VISIBLE * problem.floor)
    if not told:
        return problem, fit
    problem = replace(problem, shared=told)
    simulated = SimulatedRobot(problem.robot, nuisance_placements(problem, found))
    start = simulated.space.vector({p.name: p.start for p in simulated.space.parameters} | found)
    near = begin(replace(fit.objective, simulated=simulated), simulated.space.to_unit(start))
    return problem, descend(near, None, iterations=8)


def calibrated(objective: Objective) -> Fit:
    """The search of `edream calibrate`, which from far away finds its way by short pieces of motion and joint by joint."""
    near, _ = polish_in_stages(objective, beginning(objective), NEAR, PASS)
    end = finish(objective, near.values, LAST)
    unit = objective.simulated.space.to_unit(end.values)
    return Fit(objective, unit, end.residual, end.jacobian, worth(objective, end.residual))


def raised(fit: Fit) -> Fit:
    """The fit, or a better one from the published values of the numbers that sank far below them, the others as they are.

    A number that is searched by its logarithm moves hardly anything where it is small: once the first steps have sunk it, while
    other numbers were still far off, it does not come up again.
    """
    space, start = fit.space, fit.space.start()
    by_ratio = np.array([parameter.scale == "log" for parameter in space.parameters])
    sunk = by_ratio & (fit.values < start / CREDIBLE_FACTOR)
    if not sunk.any():
        return fit
    again = begin(fit.objective, space.to_unit(np.where(sunk, start, fit.values)))
    return min(fit, descend(again, None, iterations=8, tolerance=0.01), key=lambda one: one.rms)


def _rescaled(fit: Fit, believed: SimulatedRobot) -> np.ndarray:
    """The Jacobian for a space with the same parameters and the same boxes; only priors differ."""
    if believed.space.names != fit.space.names:
        raise ValueError("the spaces differ in more than their priors")
    return fit.jacobian


def credible(fit: Fit) -> bool:
    """Whether every fitted number lies within a factor of 2.5 of the published one (those published as 0 aside)."""
    start = fit.space.start()
    known = start > 0.0
    ratio = fit.values[known] / start[known]
    return bool(np.all((ratio > 1.0 / CREDIBLE_FACTOR) & (ratio < CREDIBLE_FACTOR)))
