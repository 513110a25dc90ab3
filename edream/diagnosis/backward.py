"""Backward steps: effects that later ones explain go out again."""

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
from jaxtyping import Float

from edream.core.parameters import Parameter
from edream.diagnosis.candidates import Candidate, acted_on, standing, untouched
from edream.diagnosis.descent import Fit, begin, descend, polish
from edream.diagnosis.left_out import bootstrap, gap_above_floor, is_material, left_out_errors
from edream.diagnosis.problem import Problem
from edream.diagnosis.starts import as_published
from edream.diagnosis.trials import Trial
from edream.sim.least_squares import worth

BOUND = 1e-3  # of the unit box: nearer, a number sits at its bound
ROUNDING = 1e-9  # a bound of a box that went through its logarithm
NEARER = 0.95  # of a fit's error: what is left without a candidate where the fit stands in a false valley


def backward(problem: Problem, fit: Fit, named: Sequence[Candidate], first: Float[np.ndarray, "M"]) -> tuple[Fit, list[Candidate]]:
    """Take out effects that later ones explain: those without which left-out motions are predicted as well, or all but.

    What is asked of an effect that comes later is asked of the earlier ones beside it, too.
    `first` are the errors of motions left out [rad^2], (M,), with nothing named.
    """
    kept = list(named)
    for candidate in list(named)[:-1] if len(named) > 1 else []:
        errors = left_out_errors(problem, fit)
        refitted = refitted_without(problem, fit, candidate)
        without_it = left_out_errors(problem, refitted)
        low, _ = bootstrap(without_it - errors, problem.settings.seed)
        others = [one for one in kept if one != candidate]
        gap = gap_above_floor(problem, without_it)
        gains = low > 0.0 and float((without_it - errors).mean()) / gap >= problem.settings.gain
        if not (gains and is_material(problem, first, (without_it, refitted), (errors, fit), untouched(problem, others))):
            fit, kept = refitted, others
    return fit, kept


def still_standing(problem: Problem, fit: Fit, kept: Sequence[Candidate]) -> tuple[Fit, list[Candidate]]:
    """What stayed, without the names whose intervals hold their absence since others came beside them or went out."""
    left = list(kept)
    for candidate in reversed(kept):
        fit = fit if fit.ended or len(left) < 2 else polish(fit)  # where intervals are true
        if len(left) > 1 and not stands(problem, candidate, fit):
            fit, left = refitted_without(problem, fit, candidate), [one for one in left if one != candidate]
    return fit, left


def passes(problem: Problem, trial: Trial) -> bool:
    """Whether a refitted candidate may be named: large enough, sure, its own numbers away from nothing and from their bounds."""
    return trial.closed >= problem.settings.gain and trial.sure and stands(problem, trial.candidate, trial.fit)


def stands(problem: Problem, candidate: Candidate, fit: Fit) -> bool:
    """Whether some parameter of the effect has an interval that excludes its absence, and none of those sits at a bound."""
    place = standing(problem, candidate, fit.objective.simulated)
    return any(is_away(fit, parameter) for parameter in place.parameters(problem.robot.model) if parameter.absent is not None)


def is_away(fit: Fit, parameter: Parameter) -> bool:
    """Whether a number's interval excludes the value at which its effect is not there, and it sits at no bound but nature's."""
    low, high = fit.intervals()[parameter.name]
    unit = float(fit.unit[fit.space.names.index(parameter.name)])  # in the box that is searched, logarithmic for a limit
    excludes = parameter.absent is not None and not low - ROUNDING * abs(low) <= parameter.absent <= high + ROUNDING * abs(high)
    return excludes and (parameter.attained or BOUND <= unit <= 1.0 - BOUND)


def nearer_without(fit: Fit, trials: Sequence[Trial]) -> Fit | None:
    """The fit gone down from the numbers that some candidate found, without it; None where those are no nearer to the motions.

    Numbers that meet the motions better than the fit's, with nothing added, prove that the fit stands in a false valley, and that
    candidates gained by leaving it.
    """
    bare = min((without(trial.fit, trial.candidate) for trial in trials), key=lambda one: one.rms, default=None)
    if bare is None or bare.rms >= NEARER * fit.rms:
        return None
    ended = descend(bare, None, 8)
    return ended if ended.rms < NEARER * fit.rms else None  # priors may have led away again


@lru_cache(maxsize=8)  # names that stay are asked about once more, by their doubts
def refitted_without(problem: Problem, fit: Fit, *candidates: Candidate) -> Fit:
    """The fit without some effects, from where it is and, for its numbers may have made up for something, from published ones."""
    smaller = fit
    for candidate in candidates:
        smaller = without(smaller, candidate)
    space, plain = smaller.space, smaller.values
    for candidate in candidates:
        plain = as_published(problem, space.names, plain, acted_on(candidate))
    again = begin(smaller.objective, np.clip(space.to_unit(plain), 0.0, 1.0))
    return min((descend(smaller, None, 3), descend(again, None, 6)), key=lambda one: one.rms)


def without(fit: Fit, candidate: Candidate) -> Fit:
    """The fit's model without one effect, from the same values of all others."""
    simulated = fit.objective.simulated
    gone = next(p for p in simulated.placements if (p.effect.name, p.targets) == (candidate.effect, candidate.targets))
    dropped = {p.name for p in gone.parameters(simulated.robot.model)}
    keep = np.array([name not in dropped for name in fit.space.names])
    smaller = replace(fit.objective, simulated=simulated.with_placements([p for p in simulated.placements if p is not gone]))
    residual = smaller.residuals(smaller.simulated.space.from_unit(fit.unit[keep]))[0]
    return Fit(smaller, fit.unit[keep], residual, fit.jacobian[:, keep], worth(smaller, residual))
