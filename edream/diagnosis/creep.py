"""Dry friction that lets a stuck joint creep: a usual number more, where motions ask for that and for no name instead."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from edream.catalog import load
from edream.core.effect import Effect
from edream.diagnosis.candidates import Candidate, library, placement
from edream.diagnosis.descent import Fit, begin, descend, polish
from edream.diagnosis.left_out import (
    SEEN,
    bootstrap,
    gap_above_floor,
    joint_errors,
    leaves_no_gap,
    left_out_errors,
    left_out_squares,
    worst_joint,
)
from edream.diagnosis.problem import Problem
from edream.diagnosis.screen import Scored, acts_already, extend
from edream.diagnosis.starts import beside_either, either_way
from edream.diagnosis.trials import Trial, gone_on, judged, leaves_little, on_few, residual_among
from edream.sim.objective import Objective, rms

FRICTION = "coulomb"
FIRST, FURTHER = 4, 6  # steps on a few motions, and on all
ARRIVING = 12  # steps of an effect together with friction that creeps: neither is near its end without the other
TOGETHER = 0.5  # of the squared error above the floor that an effect or creeping leaves, on all joints and on one
MOST = 0.5  # of the joints: on more than that it is how a robot is made
LOUD = 2.0  # times the error that joints have in the median: one that is off more lacks something of its own
FEWEST = 3  # quiet joints that may speak for all
LEAST = 1.0  # of the floor squared: a gap on quiet joints
FAR = 0.5  # of what creeping closes: an effect that closes less by its first refit is searched for beside friction that creeps


@dataclass(frozen=True, eq=False)
class Creeping:
    """A problem whose dry friction lets stuck joints creep, its fit, and that fit's errors on motions left out [rad^2], (M,)."""

    problem: Problem
    fit: Fit
    errors: Float[np.ndarray, "M"]


def creeping(problem: Problem, fit: Fit, errors: Float[np.ndarray, "M"]) -> Creeping | None:
    """The model with friction that creeps, in the form that suits the motions best; None where that surely gains nothing on those
    left out, whose `errors` are without it [rad^2], (M,), or the share of the gap that an effect must close is not met.

    Where a few joints are off far more than the others by something of their own, it may be the others that ask for it.
    """
    forms = _forms(problem, fit)
    if not forms or (seen := _seen_on_few(problem, fit, forms)) is None:
        return None
    best, form = seen
    softer = replace(problem, creep=form)
    begun = [_softened(fit, one, form, 0) for one in (best, fit)]  # what suits a few motions may lead all of them astray
    end = descend(min(begun, key=lambda one: one.rms), None, FURTHER)
    squares = left_out_squares(softer, end)
    left = squares.mean(axis=1)
    low, _ = bootstrap(errors - left, problem.settings.seed)
    enough = errors.mean() - left.mean() >= problem.settings.gain * (errors.mean() - problem.floor**2)
    return Creeping(softer, end, left) if (low > 0.0 and enough) or _mends_quiet_joints(problem, fit, squares) else None


def _seen_on_few(problem: Problem, fit: Fit, forms: Sequence[Effect]) -> tuple[Fit, Effect] | None:
    """The form that suits a few motions best, begun there, where it gains as much as an effect must, or does on quiet joints alone.

    Steps that follow what loud ones lack lead the others nowhere.
    """
    few = on_few(problem, fit)
    for some in (few, *quiet_ones_alone(problem, few)):
        best, form = min(((_softened(some, fit, form, FIRST), form) for form in forms), key=lambda one: one[0].rms)
        if some.rms**2 - best.rms**2 >= problem.settings.gain * (some.rms**2 - problem.floor**2):
            return best, form
    return None


def _mends_quiet_joints(problem: Problem, fit: Fit, squares: Float[np.ndarray, "M J"]) -> bool:
    """Whether friction that creeps, with these errors on motions left out [rad^2], surely leaves less than half on quiet joints."""
    quiet = quiet_joints(problem, fit)
    if quiet is None:
        return False
    before, after = (one[:, quiet].mean(axis=1) for one in (left_out_squares(problem, fit), squares))
    low, _ = bootstrap(before - after, problem.settings.seed)
    return low > 0.0 and _mends(problem, float(before.mean()), float(after.mean()))


def _mends(problem: Problem, before: float, after: float) -> bool:
    """Whether there is a gap that is large enough to count, and less than half of it left; by mean squared errors [rad^2]."""
    gap = before - problem.floor**2
    return gap > LEAST * problem.floor**2 and after - problem.floor**2 < TOGETHER * gap


def quiet_joints(problem: Problem, fit: Fit) -> Bool[np.ndarray, "J"] | None:
    """The joints that are not off far more than joints are in the median, (J,); None where all are so, or too few speak for all."""
    errors = joint_errors(problem, fit)
    quiet = errors <= LOUD * np.median(errors)
    return quiet if not quiet.all() and quiet.sum() >= FEWEST else None


def quiet_ones_alone(problem: Problem, few: Fit) -> list[Fit]:
    """A fit on its quiet joints alone; nothing where there are none."""
    if (quiet := quiet_joints(problem, few)) is None:
        return []
    columns = problem.counted.copy()
    columns[problem.counted] = quiet
    rows = np.tile(quiet, len(few.residual) // len(quiet))
    offset = None if few.objective.offset is None else few.objective.offset[rows]
    objective = replace(few.objective, joints=columns, offset=offset, simulations=0)
    return [replace(few, objective=objective, residual=few.residual[rows], jacobian=few.jacobian[rows])]


def outdoes(found: Creeping, trials: Sequence[Trial], seed: int) -> bool:
    """Whether motions left out speak for friction that creeps and against every effect that surely helps."""
    return all(bootstrap(t.errors - found.errors, seed)[0] > 0.0 for t in trials if t.sure)


def is_missing(found: Creeping, problem: Problem, fit: Fit, errors: Float[np.ndarray, "M"], trials: Sequence[Trial]) -> bool:
    """Whether friction that creeps is to be a usual number before any effect is looked for further."""
    ahead = is_far_ahead(found, problem, errors, trials) or is_made_so(found, problem, fit, trials)
    return ahead or is_missing_beside(found, problem, trials)


def is_far_ahead(found: Creeping, problem: Problem, errors: Float[np.ndarray, "M"], trials: Sequence[Trial]) -> bool:
    """Whether no effect comes near what friction that creeps closes, by first refits; each is searched for beside it then.

    `errors` are of motions left out, with neither [rad^2], (M,).
    """
    closed = float(errors.mean() - found.errors.mean()) / gap_above_floor(problem, errors)
    return all(t.closed < FAR * closed for t in trials)


def is_missing_beside(found: Creeping, problem: Problem, trials: Sequence[Trial]) -> bool:
    """Whether friction that creeps is missing on most joints beside the best effect: both leave less than half of what either does.

    What most joints have is how a robot is made, and stands in for no effect on one of them. Without it every effect is judged by
    what it leaves.
    """
    best = max((t for t in trials if t.sure), key=lambda t: t.closed, default=None)
    if best is None:
        return False
    few = on_few(found.problem, found.fit)
    by_effect, by_both = residual_among(few, best.fit), _beside(found, few, best).residual
    left = float(np.mean(by_both**2)) - problem.floor**2
    if left >= TOGETHER * (min(float(np.mean(by_effect**2)), few.rms**2) - problem.floor**2):
        return False
    return float(np.mean(_mended(problem, by_effect, by_both))) > MOST


def is_made_so(found: Creeping, problem: Problem, fit: Fit, trials: Sequence[Trial]) -> bool:
    """Whether friction that creeps leaves, on joints that are quiet in a fit, less than half of what any effect does that helps.

    What these have alike is how a robot is made, whatever the loud ones lack: beside it that is found sooner.
    """
    if (quiet := quiet_joints(problem, fit)) is None:
        return False

    def left(one: Fit) -> float:
        return float((joint_errors(problem, one)[quiet] ** 2).mean())

    return _mends(problem, min(map(left, [fit, *(t.fit for t in trials if t.sure)])), left(found.fit))


def creeping_with(problem: Problem, fit: Fit, trials: Sequence[Trial]) -> tuple[Creeping, Trial] | None:
    """Friction that creeps and an effect that does nothing without it, on the joint that is off most, where motions show both.

    Together they leave less than half of what the best effect leaves there, and friction that creeps mends most joints; neither
    need gain anything alone. None where they do not, and where an effect alone leaves little.
    """
    forms, best = _forms(problem, fit), max((t for t in trials if t.sure), key=lambda t: t.closed, default=None)
    if not forms or (best is not None and leaves_little(problem, best)):
        return None
    few, joint = on_few(problem, fit), worst_joint(problem, fit)
    there = [Candidate(effect.name, (joint,)) for effect in library(problem) if effect.of_creep]
    places = [one for one in there if not acts_already(one, fit.objective.simulated.placements)]
    if not places:
        return None
    softer, soft = replace(problem, creep=forms[0]), _softened(few, fit, forms[0], FIRST)
    near, candidate = min(((_arrived(softer, soft, one), one) for one in places), key=lambda one: one[0].rms)
    ends = [(near, forms[0]), *((_softened(near, near, form, FIRST), form) for form in forms[1:])]
    both, form = min(ends, key=lambda one: one[0].rms)
    by_effect = few.residual if best is None else residual_among(few, best.fit)
    mended = _mended(problem, by_effect, both.residual)
    if not mended[problem.joints.index(joint)] or np.mean(mended) <= MOST:
        return None
    softer = replace(problem, creep=form)
    end = _softened(fit, both, form, FURTHER)
    errors = left_out_errors(softer, end)
    lead = judged(softer, gone_on(end, both), errors, Scored(candidate, {}, 0.0))
    return (Creeping(softer, end, errors), lead) if lead.sure else None


def softened(found: Creeping, trial: Trial) -> Trial:
    """A refitted candidate with friction that creeps beside it."""
    form = found.problem.creep
    assert form is not None
    return judged(found.problem, polish(_softened(trial.fit, trial.fit, form, ARRIVING)), found.errors, trial)


def _forms(problem: Problem, fit: Fit) -> tuple[Effect, ...]:
    """Forms of dry friction that creeps which a model may still get; none where it has one, or no gap."""
    settled = FRICTION not in problem.settings.nuisance or problem.creep is not None or leaves_no_gap(problem, fit)
    return () if settled else load("effects", FRICTION, Effect).softer


def _mended(problem: Problem, before: Float[np.ndarray, "R"], after: Float[np.ndarray, "R"]) -> Bool[np.ndarray, "J"]:
    """Which joints showed a gap by a residual [rad], and by another one less than half of it."""
    was, now = ((one.reshape(-1, len(problem.joints)) ** 2).mean(axis=0) - problem.floor**2 for one in (before, after))
    return (was > SEEN * problem.floor**2) & (now < TOGETHER * was)


def _arrived(problem: Problem, few: Fit, candidate: Candidate) -> Fit:
    """A candidate beside a fit, from the nearest of all its strengths, its joint's usual numbers as they are or as published."""
    place = placement(problem, candidate)
    extended, absent = extend(few, [place])
    return _nearest_gone_down(extended, either_way(problem, place, extended, absent), ARRIVING)


def _beside(found: Creeping, few: Fit, best: Trial) -> Fit:
    """An effect beside friction that creeps on a few motions, from the numbers of either alone that are nearer with both."""
    place = placement(found.problem, best.candidate)
    extended, absent = extend(few, [place])
    ended = best.fit.space.mapping(best.fit.values)
    return _nearest_gone_down(extended, beside_either(found.problem, place, extended, absent, ended), FURTHER)


def _nearest_gone_down(objective: Objective, starts: Sequence[Float[np.ndarray, "P"]], steps: int) -> Fit:
    """A model some steps from those of several numbers that are nearest to the motions."""
    nearest = int(np.argmin([rms(residual) for residual in objective.residuals(np.array(starts))]))
    return descend(begin(objective, np.clip(objective.simulated.space.to_unit(starts[nearest]), 0.0, 1.0)), None, steps)


def _softened(fit: Fit, start: Fit, form: Effect, steps: int) -> Fit:
    """A fit with another form of dry friction on its motions, some steps from the numbers of another, which may have that form."""
    simulated = fit.objective.simulated
    placements = [replace(one, effect=form) if one.effect.name == FRICTION else one for one in simulated.placements]
    softer = simulated.with_placements(placements)
    found = start.space.mapping(start.values)
    unit = softer.space.to_unit(np.array([found.get(p.name, p.start) for p in softer.space.parameters]))
    return descend(begin(replace(fit.objective, simulated=softer, simulations=0), np.clip(unit, 0.0, 1.0)), None, steps)
