"""Forward steps: effects are added while they pass, the best on motions left out first."""

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float

from edream.diagnosis.astray import screen_twice
from edream.diagnosis.backward import nearer_without, passes, stands
from edream.diagnosis.candidates import untouched
from edream.diagnosis.creep import creeping, creeping_with, is_missing, outdoes, softened
from edream.diagnosis.decide import Round, restarted, settled, simplest, simplified, told_apart, with_confusable
from edream.diagnosis.descent import Fit, polish
from edream.diagnosis.ends import arrived
from edream.diagnosis.finer import finest
from edream.diagnosis.instead import doubted_instead
from edream.diagnosis.left_out import asks_for_more, bootstrap, falls_short, is_material, leaves_no_gap
from edream.diagnosis.narrowing import narrowed
from edream.diagnosis.outwards import outermost
from edream.diagnosis.problem import Problem
from edream.diagnosis.remainder import Remainder, find_remainder
from edream.diagnosis.steps import with_short_steps
from edream.diagnosis.trials import Trial, best_of_each, predicted, try_best, with_bold
from edream.diagnosis.wanting import with_put_back, with_rough

CLEARLY = 0.75  # of the squared error above the floor that a stand-in leaves
STAND_INS = 2  # names that together close less than half of a real gap: no further one is looked for


def forward(
    problem: Problem,
    fit: Fit,
    done: Callable[[str, int], object] = lambda text, n: None,
    taken_before: Sequence[Round] = (),
    known: Sequence[Trial] = (),
) -> tuple[Problem, Fit, list[Round]]:
    """Add effects while they pass, the best on left-out motions first; before each, steps are made as short as they need to be.

    Where friction that lets stuck joints creep does better than every candidate, or shows together with one alone, it becomes a
    usual number.

    An earlier name gives way to what it was not told from, where that leaves far less beside the one that came last.

    The first round begins anew as long as candidates show that the usual numbers stand in a false valley. `taken_before` are rounds
    that led to the fit, if any, and `known` candidates beside it that have been refitted already.

    Returns:
        The problem with the steps that were taken, the final fit, and every round, the last of which took nothing unless the most
        effects were reached.
    """
    rounds, leads = list(taken_before), list(known)
    while len(rounds) < problem.settings.most:
        problem, fit = with_short_steps(problem, fit)
        errors = predicted(problem, fit, rounds[-1].taken if rounds else None)
        first = rounds[0].errors if rounds else errors
        bare = untouched(problem, [one.taken.candidate for one in rounds if one.taken is not None])
        told = asks_for_more(problem, fit, first, errors, bare)
        if not told or (len(rounds) >= STAND_INS and falls_short(problem, first, errors)):
            rounds.append(Round(fit, errors, [], [], None))
            break
        scored = screen_twice(problem, fit, lambda n: done("screening", n))
        trials = best_of_each([*try_best(problem, fit, errors, scored, lambda n: done("refitting", n)), *leads])
        # beside names that were taken it would ask whether those still stand
        if not rounds and (nearer := nearer_without(fit, trials)) is not None:
            fit = nearer  # so much nearer that this ends
            continue
        softer = creeping(problem, fit, errors)
        if softer is not None and is_missing(softer, problem, fit, errors, trials):
            problem, fit, leads = softer.problem, softer.fit, [softened(softer, one) for one in leads]
            continue
        if (together := creeping_with(problem, fit, trials)) is not None:
            softer, lead = together
            problem, fit, leads = softer.problem, softer.fit, [lead]
            continue
        if not rounds:  # later ones begin at numbers that make up for less
            trials = with_bold(problem, fit, errors, trials, lambda n: done("searching", n))
        trials = with_rough(problem, fit, errors, trials, lambda n: done("searching", n))
        trials = with_put_back(problem, fit, errors, trials, lambda n: done("searching", n))
        trials = with_confusable(problem, fit, errors, scored, trials, lambda n: done("refitting", n))
        trials = settled(problem, fit, errors, trials)
        trials = restarted(problem, errors, trials)
        trials = simplified(problem, fit, errors, trials)
        if softer is not None and outdoes(softer, trials, problem.settings.seed):
            problem, fit, leads = softer.problem, softer.fit, [softened(softer, one) for one in leads]
            continue
        if not rounds and (formula := outdone(problem, fit, errors, trials)) is not None:
            rounds.append(Round(fit, errors, scored, trials, None, formula))
            break
        passing = [t for t in trials if passes(problem, t) and matters(problem, first, errors, fit, t, bare)]
        taken, ended = first_that_stands(problem, fit, passing)
        if taken is not None and (fewer := narrowed(problem, fit, errors, taken, ended)) is not None:
            trial, there = fewer
            if stands(problem, trial.candidate, there) and not told_apart(problem, trial, taken):
                taken, ended = trial, there
        if taken is not None:
            there = [t for t in passing if t.candidate.targets == taken.candidate.targets and t.candidate != taken.candidate]
            taken, ended = finest(problem, fit, errors, taken, ended, there)
            taken, ended, same = outermost(problem, errors, taken, ended)
            others = [t for t in trials if t.candidate not in same | {taken.candidate}]
            trials = sorted([taken, *others], key=lambda t: -t.closed)
        rounds.append(Round(fit, errors, scored, trials, taken))
        leads = []
        if taken is None:
            break
        fit, rounds = doubted_instead(problem, ended, rounds, lambda n: done("exchanging names", n))
    return problem, fit, rounds


def outdone(problem: Problem, fit: Fit, errors: Float[np.ndarray, "M"], trials: Sequence[Trial]) -> Remainder | None:
    """A formula that leaves clearly less than the best candidate does, where that closes less than half of a real gap.

    The largest of several effects closes half of what they do together, mostly; what closes less is a stand-in.
    """
    best = max((t for t in trials if t.sure), key=lambda t: t.closed, default=None)
    left = errors if best is None else best.errors
    found = find_remainder(problem, fit) if falls_short(problem, errors, left) else None
    if found is None or not found.real:
        return None
    better, _ = bootstrap(left - found.errors, problem.settings.seed)
    floor = problem.floor**2
    return found if better > 0.0 and found.errors.mean() - floor < CLEARLY * (left.mean() - floor) else None


def first_that_stands(problem: Problem, fit: Fit, passing: Sequence[Trial]) -> tuple[Trial | None, Fit]:
    """The best of the candidates that pass and still do at the end of their search, where intervals are true; and the fit there.

    Before, one may seem to be known that lets a number beside its own (where the servo's damping acts) close the gap.
    """
    left = list(passing)
    while (taken := simplest(problem, left)) is not None:
        here = taken.fit.ended and leaves_no_gap(problem, taken.fit)
        ended = taken.fit if here else polish(arrived(problem, fit, taken))
        if stands(problem, taken.candidate, ended):
            return taken, ended
        left.remove(taken)
    return None, fit


def matters(
    problem: Problem, first: Float[np.ndarray, "M"], errors: Float[np.ndarray, "M"], fit: Fit, trial: Trial, bare: frozenset[str]
) -> bool:
    """Whether a candidate's gain is worth a name beside the gap that was there at first; always so for the first one."""
    return first is errors or is_material(problem, first, (errors, fit), (trial.errors, trial.fit), bare)
