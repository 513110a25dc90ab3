"""Ends of candidates' searches: down to the end of a valley, and from a second side where it may be a false one."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from edream.diagnosis.candidates import Candidate, acted_on, placement
from edream.diagnosis.descent import Fit, begin, descend, polish
from edream.diagnosis.left_out import joint_errors, leaves_no_gap
from edream.diagnosis.problem import VISIBLE, Problem
from edream.diagnosis.screen import extend, with_quantities
from edream.diagnosis.side_by_side import side_by_side
from edream.diagnosis.starts import as_published, fresh_columns, strong_probes
from edream.diagnosis.trials import Trial
from edream.sim.least_squares import worth
from edream.sim.objective import rms

SHAPED = 1.5  # floors of error from which a winner is tried in its other shapes
SHAPES = 3  # so many of them


def begun_again(problem: Problem, fits: Sequence[Fit], candidates: Sequence[Candidate]) -> list[Fit]:
    """The fits, the nearest of those that leave their joints off also from where their effect stands beside published numbers.

    Where servos reach their limits, those that made up for it on the way may stand in a false valley that no descent leaves.
    """

    def again(number: int) -> Fit:
        fit, joints = fits[number], acted_on(candidates[number])
        if number not in nearest:
            return fit
        start = fit.space.to_unit(as_published(problem, fit.space.names, fit.values, joints))
        # so far off, links seem to pull at each other that do not
        near = replace(begin(fit.objective, np.clip(start, 0.0, 1.0)), pulling=fit.pulling)
        return min(fit, descend(near, None, 8), key=lambda one: one.rms)

    order = np.argsort([fit.rms for fit in fits], kind="stable").tolist()
    left = [
        off_on(problem, fit, acted_on(one)) > (1.0 + VISIBLE) * problem.floor for fit, one in zip(fits, candidates, strict=True)
    ]
    nearest = [number for number in order if left[number]][:SHAPES]
    return list(side_by_side(again, range(len(fits)), problem.settings.threads))


def off_on(problem: Problem, fit: Fit, joints: frozenset[str]) -> float:
    """The largest error of some joints [rad]; 0 of none."""
    errors = zip(problem.joints, joint_errors(problem, fit), strict=True)
    return max((float(error) for joint, error in errors if joint in joints), default=0.0)


def to_their_ends(problem: Problem, fits: Sequence[Fit]) -> list[Fit]:
    """The fits, the nearest ones gone down to the end of their valleys; once one leaves no gap, only those that are near it."""
    found, arrived_one = list(fits), False
    for number in np.argsort([fit.rms for fit in fits], kind="stable")[:SHAPES].tolist():
        if not arrived_one or fits[number].rms <= SHAPED * problem.floor:
            found[number] = polish(fits[number])
            arrived_one |= leaves_no_gap(problem, found[number])
    return found


def arrived(problem: Problem, before: Fit, taken: Trial) -> Fit:
    """The winner's fit gone down to the end; where that leaves a gap, from its other shapes as well.

    Those begin at the nuisance numbers from before it, which have not yet made up for a wrong shape.
    """
    fit = descend(replace(taken.fit, scale=worth(taken.fit.objective, taken.fit.residual)), None, 4)
    place = placement(problem, taken.candidate)
    extended, absent = extend(before, [place])
    sets = [with_quantities(extended, absent, [place], [shape]) for shape in strong_probes(problem, place)]
    if fit.rms <= SHAPED * problem.floor or len(sets) < 2:
        return fit
    residuals = extended.residuals(np.array(sets))
    promising = np.argsort([rms(r) for r in residuals], kind="stable")[:SHAPES]
    own, space = fresh_columns(before, extended), extended.simulated.space
    starts = [np.clip(space.to_unit(sets[number]), 0.0, 1.0) for number in promising]
    others = side_by_side(lambda start: descend(begin(extended, start), own, 3), starts, problem.settings.threads)
    again = descend(min(others, key=lambda other: other.rms), None, 4)
    return again if again.rms < fit.rms else fit
