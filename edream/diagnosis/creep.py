"""Dry friction that lets a stuck joint creep: a usual number more, where motions ask for that and for no name instead."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from edream.catalog import load
from edream.core.effect import Effect
from edream.diagnosis.candidates import Candidate, library, placement
from edream.diagnosis.descent import Fit, begin, descend, polish
from edream.diagnosis.left_out import SEEN, bootstrap, gap_above_floor, leaves_no_gap, left_out_errors, worst_joint
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
FAR = 0.5  # of what creeping closes: an effect that closes less by its first refit is searched for beside friction that creeps


@dataclass(frozen=True, eq=False)
class Creeping:
    """A problem whose dry friction lets stuck joints creep, its fit, and that fit's errors on motions left out [rad^2], (M,)."""

    problem: Problem
    fit: Fit
    errors: Float[np.ndarray, "M"]


def creeping(problem: Problem, fit: Fit, errors: Float[np.ndarray, "M"]) -> Creeping | None:
    """The model with friction that creeps, in the form that suits the motions best; None where that surely gains nothing on those
    left out, whose `errors` are without it [rad^2], (M,), or the share of the gap that an effect must close is not met."""
    forms = _forms(problem, fit)
    if not forms:
        return None
    few, least = on_few(problem, fit), problem.settings.gain
    best, form = min(((_softened(few, fit, form, FIRST), form) for form in forms), key=lambda one: one[0].rms)
    if few.rms**2 - best.rms**2 < least * (few.rms**2 - problem.floor**2):
        return None
    softer = replace(problem, creep=form)
    begun = [_softened(fit, one, form, 0) for one in (best, fit)]  # what suits a few motions may lead all of them astray
    end = descend(min(begun, key=lambda one: one.rms), None, FURTHER)
    left = left_out_errors(softer, end)
    low, _ = bootstrap(errors - left, problem.settings.seed)
    enough = errors.mean() - left.mean() >= least * (errors.mean() - problem.floor**2)
    return Creeping(softer, end, left) if low > 0.0 and enough else None


def outdoes(found: Creeping, trials: Sequence[Trial], seed: int) -> bool:
    """Whether motions left out speak for friction that creeps and against every effect that surely helps."""
    return all(bootstrap(t.errors - found.errors, seed)[0] > 0.0 for t in trials if t.sure)


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
