"""An effect's finer form, of one number more, where the plain one leaves a gap."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from edream.catalog import load
from edream.core.effect import Effect
from edream.diagnosis.backward import is_away, stands
from edream.diagnosis.candidates import Candidate, acted_on, standing
from edream.diagnosis.descent import Fit, begin, descend, polish
from edream.diagnosis.ends import arrived
from edream.diagnosis.left_out import REAL_GAP, is_real, joint_errors
from edream.diagnosis.problem import Problem
from edream.diagnosis.side_by_side import side_by_side
from edream.diagnosis.starts import with_column
from edream.diagnosis.trials import Trial, judged, predicted
from edream.sim.objective import Objective
from edream.sim.simulation import Placement

STEPS = (0.0, 0.05, -0.05)  # of its range, from its absence: where a number begins that others have made up for


def finest(
    problem: Problem, before: Fit, errors: Float[np.ndarray, "M"], taken: Trial, ended: Fit, rivals: Sequence[Trial]
) -> tuple[Trial, Fit]:
    """The effect in its finer form where that is asked for, or a rival whose finer form does better than either.

    A further number of a rival's may be what the effect's own made up for: friction with the square of the load looks like one that
    differs between lifting and lowering as long as it has to be in proportion.

    Args:
        before: the fit without the effect.
        errors: of that fit on motions left out [rad^2], (M,).
        taken: the effect, its search at `ended`.
        rivals: trials of other effects in its place; plain they may do worse, for want of that number.

    Returns:
        The effect as it is taken, and the end of its search.
    """
    best, fit = with_finer(problem, errors, taken, ended)
    for rival in rivals:
        finer = load("effects", rival.candidate.effect, Effect).finer
        if finer is None or not is_left_on(problem, fit, acted_on(taken.candidate)):
            continue
        found = in_finer_form(problem, errors, rival, polish(arrived(problem, before, rival)))
        if found is None:
            continue
        other, there, _ = found
        better = closes_more(problem, fit, there) and other.errors.mean() < best.errors.mean()
        if better and stands(problem, other.candidate, there):
            best, fit = other, there
    return best, fit


def with_finer(problem: Problem, errors: Float[np.ndarray, "M"], taken: Trial, ended: Fit) -> tuple[Trial, Fit]:
    """An effect in its finer form where its plain one leaves a real gap on its own joint; as it is otherwise.

    The finer one has to take the share `gain` of that gap in the fit, do no worse on motions left out, and have a further number
    that is surely not absent. What a form that is not quite right leaves looks like further effects, none of them there.

    Args:
        errors: on motions left out [rad^2], (M,), without the effect.
        taken: the effect, its search at `ended`.

    Returns:
        The effect as it is taken, and the end of that search.
    """
    found = in_finer_form(problem, errors, taken, ended)
    if found is None:
        return taken, ended
    trial, fit, known = found
    more = standing(problem, taken.candidate, fit.objective.simulated).parameters(problem.robot.model)[-1]
    better = closes_more(problem, ended, fit) and trial.errors.mean() < known.mean()
    return (trial, fit) if better and is_away(fit, more) else (taken, ended)


def in_finer_form(
    problem: Problem, errors: Float[np.ndarray, "M"], taken: Trial, ended: Fit
) -> tuple[Trial, Fit, Float[np.ndarray, "M"]] | None:
    """An effect in its finer form, where there is one and the plain one leaves a real gap on its joint.

    Returns:
        The effect, the end of its search, and the errors on motions left out [rad^2], (M,), of the plain one.
    """
    finer = load("effects", taken.candidate.effect, Effect).finer
    if finer is None or not is_left_on(problem, ended, acted_on(taken.candidate)):
        return None
    if not is_real(problem, known := predicted(problem, ended, taken)):
        return None
    simulated = ended.objective.simulated
    plain = standing(problem, taken.candidate, simulated)
    place = replace(plain, effect=finer)
    more = place.parameters(problem.robot.model)[-1]
    if more.absent is None or more.name in simulated.space.names:
        return None
    longer = simulated.with_placements([*(one for one in simulated.placements if one is not plain), place])  # it was last
    extended = replace(ended.objective, simulated=longer, simulations=0)
    begun = [more.absent + step * (more.high - more.low) for step in STEPS]
    ends = side_by_side(lambda value: gone_down(ended, extended, value), begun, problem.settings.threads)
    fit = min(ends, key=lambda one: one.rms)
    return judged(problem, fit, errors, taken), fit, known


def closes_more(problem: Problem, fit: Fit, other: Fit) -> bool:
    """Whether another fit takes the share `gain` of the squared error above the floor that a fit leaves."""
    left, now = fit.rms**2 - problem.floor**2, other.rms**2 - problem.floor**2
    return left - now >= problem.settings.gain * left


def with_plain(problem: Problem, fit: Fit, kept: Sequence[Candidate]) -> Fit:
    """The fit, effects in their plain form again whose further number may be none beside what came later, and is not missed."""
    for candidate in kept if len(kept) > 1 else ():
        place, plain = standing(problem, candidate, fit.objective.simulated), load("effects", candidate.effect, Effect)
        if place.effect is plain or place.effect is plain.creeping:
            continue
        more = place.parameters(problem.robot.model)[-1]
        fit = fit if fit.ended else polish(fit)  # where intervals are true
        if not is_away(fit, more):
            smaller = descend(_without_number(fit, place, plain, more.name), None, 6)
            fit = fit if closes_more(problem, smaller, fit) else smaller
    return fit


def _without_number(fit: Fit, place: Placement, plain: Effect, name: str) -> Fit:
    simulated = fit.objective.simulated
    placements = [replace(one, effect=plain) if one is place else one for one in simulated.placements]
    smaller = replace(fit.objective, simulated=simulated.with_placements(placements), simulations=0)
    return begin(smaller, fit.unit[[other != name for other in fit.space.names]])


def is_left_on(problem: Problem, fit: Fit, joints: frozenset[str]) -> bool:
    """Whether one of some joints is left with a real gap."""
    return any(
        error > REAL_GAP * problem.floor
        for joint, error in zip(problem.joints, joint_errors(problem, fit), strict=True)
        if joint in joints
    )


def gone_down(fit: Fit, extended: Objective, value: float) -> Fit:
    """The larger model from the fit and a value of its last number, at the end of its search."""
    near = with_column(fit, extended, np.append(fit.values, value))
    return polish(descend(near, None, 6))
