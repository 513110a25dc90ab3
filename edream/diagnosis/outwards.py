"""A mass on the axis of a joint: from the links to either side of it, it does the same."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from edream.diagnosis.backward import stands, without
from edream.diagnosis.candidates import Candidate, carried_by, next_to, placement
from edream.diagnosis.descent import Fit, begin, descend, polish
from edream.diagnosis.problem import STILL, Problem
from edream.diagnosis.screen import extend
from edream.diagnosis.trials import Trial, judged
from edream.sim.objective import rms

AS_WELL = 1.02  # times the error from the inner link, at the end
NEAR = 2.0  # of it, where its place comes from the inner link, that is known there no better than motions tell


def outermost(
    problem: Problem, errors: Float[np.ndarray, "M"], taken: Trial, ended: Fit
) -> tuple[Trial, Fit, frozenset[Candidate]]:
    """An effect on a link, taken to the outermost one from which it does the same.

    A tool stands on the axis of the flange that turns it, where its weight pulls as if it hung on the link before.

    Args:
        problem: robot, motions and settings.
        errors: on motions left out [rad^2], (M,), without the effect.
        taken: the effect, its search at `ended`.

    Returns:
        The effect as it is taken, the end of its search, and the links further in from which it would do the same, as candidates.
    """
    passed = set[Candidate]()
    while (found := _further_out(problem, errors, taken, ended)) is not None:
        passed.add(taken.candidate)
        taken, ended = found
    return taken, ended, frozenset(passed)


def _further_out(problem: Problem, errors: Float[np.ndarray, "M"], taken: Trial, ended: Fit) -> tuple[Trial, Fit] | None:
    """The effect on a link that its own one carries, where that does as well; None where none does."""
    own = taken.candidate
    for other in next_to(problem, own):
        between = carried_by(problem, other) - carried_by(problem, own)
        if not any(_moved_by(problem, joint) >= STILL for joint in between):
            continue  # it is no link further out, or one that motions never moved from the other
        fit = _carried_over(problem, own, other, ended)
        if fit is not None and stands(problem, other, fit):
            return judged(problem, fit, errors, replace(taken, candidate=other)), fit
    return None


def _moved_by(problem: Problem, joint: str) -> float:
    """How far a joint went in the fitted motions, from one end to the other [rad]."""
    column = problem.fitted[0].episode.joints.index(joint)
    return float(np.ptp(np.concatenate([window.measured[:, column] for window in problem.fitted])))


def _carried_over(problem: Problem, own: Candidate, other: Candidate, ended: Fit) -> Fit | None:
    """The fit with an effect on another link, at its end; None where that is no place for it, or does worse."""
    found, model = ended.space.mapping(ended.values), problem.robot.model
    here, there = placement(problem, own), placement(problem, other)
    values = {p.name: found[here.full_name(p.name)] for p in here.effect.parameters(model, own.targets)}
    moved = here.effect.on_link(model, values, own.targets[0], other.targets[0])
    if moved is None or not all(p.low <= moved[p.name] <= p.high for p in there.effect.parameters(model, other.targets)):
        return None
    extended, _ = extend(without(ended, own), [there])
    space = extended.simulated.space
    found |= {there.full_name(name): value for name, value in moved.items()}
    start = np.clip(space.to_unit(np.array([found[name] for name in space.names])), 0.0, 1.0)
    if rms(extended.residuals(space.from_unit(start))[0]) > NEAR * ended.rms:
        return None
    fit = polish(descend(begin(extended, start), None, 4))
    return fit if fit.rms <= AS_WELL * ended.rms else None
