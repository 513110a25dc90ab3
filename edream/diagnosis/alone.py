"""What one motion alone shows: it is set aside while the others are explained, then explained by what brings it to the noise.

What a robot does at its limits shows in few motions, perhaps in one. Fitted with the others, that one bends the numbers that all
of them share, and hides what they show; left out, nobody learns from the others what it shows. So no bootstrap over motions can
speak for a name that rests on it. What can: that the name's few numbers bring all of it down to the noise, beside numbers that the
others know.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from edream.catalog import load
from edream.core.effect import Effect
from edream.diagnosis.another_way import by_another_way
from edream.diagnosis.backward import stands
from edream.diagnosis.by_two import by_two
from edream.diagnosis.candidates import Candidate, acted_on, standing
from edream.diagnosis.decide import DISTINCT, Round
from edream.diagnosis.descent import Fit, begin, polish
from edream.diagnosis.few import on_motions
from edream.diagnosis.forward import forward
from edream.diagnosis.left_out import CLEAR, REAL_GAP, is_clear, is_real, least_seen, worst_joint
from edream.diagnosis.naming import Named, numbers_of
from edream.diagnosis.nearest import begun_in_all_strengths
from edream.diagnosis.never_fitted import is_left, proof_errors
from edream.diagnosis.nuisance import fit_nuisance, with_shares
from edream.diagnosis.problem import Problem
from edream.diagnosis.remainder import find_remainder
from edream.diagnosis.screen import Scored
from edream.diagnosis.side_by_side import side_by_side
from edream.diagnosis.starts import in_all_strengths
from edream.diagnosis.trials import gone_on
from edream.sim.window import Window

LEFT = 4  # motions at least that are fitted without the one that is set aside
MORE = 0.5  # of the squared error above the floor: more than all others together, which are off by numbers that the one has bent

Report = Callable[[str, int], object]


@dataclass(frozen=True, eq=False)
class Searched:
    """Where a search for names ended.

    Attributes:
        problem: with the steps that were taken.
        fit: its end.
        rounds: its rounds.
        odd: the motion that was set aside, which is neither fitted nor among those that judge.
    """

    problem: Problem
    fit: Fit
    rounds: list[Round]
    odd: Window | None = None


@dataclass(frozen=True, eq=False)
class Alone:
    """What one motion alone shows.

    Attributes:
        problem: with that motion among the fitted ones.
        fit: all that is known from the others, and what explains it.
        named: that, with its rivals.
        contenders: label and fit of each that these motions cannot tell from another; empty where they can.
        confirmed: whether motions never fitted are met better with it, by what can be seen.
    """

    problem: Problem
    fit: Fit
    named: Named
    contenders: Sequence[tuple[str, Fit]]
    confirmed: bool


def searched(problem: Problem, done: Report = lambda text, n: None) -> Searched:
    """Names from the usual numbers on; without the motion on which most of a clear gap rests, where the others tell more then.

    They do where they have names, or agree with the simulator, and no formula explains that motion with them. Where nothing is
    named, and all motions together do not bear a gap out, none is set aside. What they tell may explain that motion as well: it is
    among those never fitted then.
    """
    found = _from_usual_numbers(problem, done)
    number = rests_on_one(problem, found.rounds[-1].errors) if found.rounds[-1].taken is None else None
    if number is None or has_formula(found) or not (has_names(found) or bears_out(found)):
        return found
    odd = problem.fitted[number]
    others = replace(problem, fitted=tuple(window for window in problem.fitted if window is not odd))
    without = _from_usual_numbers(others, done)
    if is_clear(others, without.rounds[-1].errors) or (has_names(found) and not has_names(without)):
        return found
    if off_on(others, without.fit, odd)[0] > CLEAR * problem.floor:
        return replace(without, odd=odd)
    return replace(without, problem=replace(without.problem, proof=(*problem.proof, odd)))  # what the others tell explains it, too


def has_names(found: Searched) -> bool:
    """Whether a search named something."""
    return any(one.taken is not None for one in found.rounds)


def has_formula(found: Searched) -> bool:
    """Whether a formula explains what a search leaves, so that no real gap is left."""
    formula = found.rounds[0].formula or find_remainder(found.problem, found.fit, beside_names=has_names(found))
    return formula is not None and formula.real and not is_real(found.problem, formula.errors)


def bears_out(found: Searched) -> bool:
    """Whether all motions together bear out that a search without names leaves a gap."""
    return is_left(found.problem, found.rounds[-1].errors, proof_errors(found.problem, found.fit))


def _from_usual_numbers(problem: Problem, done: Report) -> Searched:
    problem, before = with_shares(problem, fit_nuisance(problem))
    done("nuisance", 1)
    found = by_two(*forward(problem, before, done), done)
    return Searched(*by_another_way(*found, done))


def rests_on_one(problem: Problem, errors: Float[np.ndarray, "M"]) -> int | None:
    """The motion on which more than half of a clear gap rests, by the mean squared errors of motions left out [rad^2], (M,)."""
    above = (errors - problem.floor**2).clip(0.0)
    worst = int(above.argmax())
    alone = len(errors) > LEFT and is_clear(problem, errors) and above[worst] >= MORE * above.sum()
    return worst if alone else None


def explained(others: Problem, fit: Fit, odd: Window) -> Alone | None:
    """What explains the motion that was set aside beside what is known from the others; None where nothing brings it to the noise.

    It is chosen by that motion; those never fitted may contradict it, or confirm it.

    Args:
        others: the problem without that motion.
        fit: all that is named there.
        odd: that motion.
    """
    problem = replace(others, fitted=(*others.fitted, odd))
    back = begin(replace(fit.objective, windows=problem.fitted, simulations=0), fit.unit)
    there = _on(back, odd)
    begun = begun_in_all_strengths(problem, there, [(worst_joint(problem, there),)], in_all_strengths)

    def ended(pair: tuple[Fit, Scored]) -> tuple[Fit, Candidate]:
        near, candidate = pair[0], pair[1].candidate
        return polish(gone_on(back, near, acted_on(candidate))), candidate

    ends = side_by_side(ended, begun, problem.settings.threads)
    explaining = sorted(
        ((left_on(end, odd), end, one) for end, one in ends if brings_down(problem, end, one, odd)), key=lambda t: t[0]
    )
    if not explaining:
        return None
    least, end, candidate = explaining[0]
    gained, seen = gain_on_others(problem, back, end), least_seen(problem)
    if gained < -seen:  # contradicted; which candidate it is they have no say in
        return None
    told = DISTINCT * max(problem.floor**2, least)
    possible = [(one.label, other) for left, other, one in explaining if left - least <= told]
    effect = load("effects", candidate.effect, Effect)
    numbers = numbers_of(problem, end, standing(problem, candidate, end.objective.simulated))
    rivals = tuple(label for label, _ in possible[1:])
    named = Named(effect.name, effect.summary, candidate.targets, *numbers, float("nan"), None, rivals, odd.episode.name)
    return Alone(problem, end, named, possible if rivals else (), gained > seen)


def brings_down(problem: Problem, end: Fit, candidate: Candidate, odd: Window) -> bool:
    """Whether a candidate stands, and leaves no real gap on the motion that was set aside, beside `end`'s other numbers."""
    return left_on(end, odd) <= (REAL_GAP * problem.floor) ** 2 and stands(problem, candidate, end)


def gain_on_others(problem: Problem, back: Fit, end: Fit) -> float:
    """By how much the mean squared error on motions never fitted is less with `end` than with `back` [rad^2]."""
    return float(proof_errors(problem, back).mean() - proof_errors(problem, end).mean())


def left_on(fit: Fit, odd: Window) -> float:
    """Mean squared error [rad^2] of a fit on one of its motions."""
    return float((_on(fit, odd).residual ** 2).mean())


def off_on(problem: Problem, fit: Fit, odd: Window) -> tuple[float, str]:
    """How far a model is off in a motion [rad], fitted to it or not, and on which joint most."""
    objective = replace(fit.objective, windows=(odd,), simulations=0)
    residual = objective.residuals(fit.values)[0]
    there = replace(fit, objective=objective, residual=residual)
    return there.rms, worst_joint(problem, there)


def _on(fit: Fit, odd: Window) -> Fit:
    """A fit on one of its motions alone."""
    return on_motions(fit, [next(i for i, window in enumerate(fit.objective.windows) if window is odd)])
