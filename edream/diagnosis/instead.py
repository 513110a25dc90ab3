"""An earlier name gives way to what it was not told from, once a later one shows the difference."""

from collections.abc import Callable, Sequence
from dataclasses import replace

from edream.diagnosis.backward import passes
from edream.diagnosis.decide import Round
from edream.diagnosis.descent import Fit
from edream.diagnosis.doubts import doubtful, held_against
from edream.diagnosis.exchange import LEFT, is_better
from edream.diagnosis.problem import Problem
from edream.diagnosis.trials import Trial


def doubted_instead(
    problem: Problem, fit: Fit, rounds: Sequence[Round], done: Callable[[int], object] = lambda n: None
) -> tuple[Fit, list[Round]]:
    """The fit and its rounds, an earlier name's rival in its place where that closes half of what all names leave.

    A weak motor and a slow setpoint on one joint leave the same, as long as the friction of the next joint is missing; beside it
    one of them leaves nothing. Told then, no further name is looked for that would only make up for the wrong one.

    Args:
        problem: with the steps that the last round took.
        fit: with all names that were taken.
        rounds: each with a name that it took.
        done: called with how many names were asked about.
    """
    out = list(rounds)
    for number in range(len(out) - 1):
        one, names = out[number], taken_in(out)
        others = doubtful(problem, one, names[number], [t.candidate for t in names])
        if not others or fit.rms <= LEFT * problem.floor:
            continue
        # what comes no nearer on first looks is not better
        again, old = held_against(problem, fit, one, names[number], others, behind=1.0)
        done(1)
        better = [t for t in again.trials if t is not old and passes(problem, t) and is_better(problem, t, old)]
        if better:
            fit, alone = better[0].fit, next(t for t in others if t.candidate == better[0].candidate)
            out[number] = replace(one, taken=alone)
            out[number + 1 :] = asked_beside(problem, fit, out, number + 1)
    return fit, out


def asked_beside(problem: Problem, fit: Fit, rounds: Sequence[Round], since: int) -> list[Round]:
    """The rounds from `since` on beside another earlier name: each as it is without those after it, its doubts asked again."""
    names, out = taken_in(rounds), list[Round]()
    for number in range(len(rounds) - 1, since - 1, -1):
        rivals = doubtful(problem, rounds[number], names[number], [t.candidate for t in names])
        again, _ = held_against(problem, fit, rounds[number], names[number], rivals)
        fit, out = again.before, [again, *out]
    return out


def taken_in(rounds: Sequence[Round]) -> list[Trial]:
    """The name that each round took."""
    return [one.taken for one in rounds if one.taken is not None]
