"""An earlier name gives way to what it was not told from, once a later one shows the difference."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

from edream.diagnosis.backward import passes, refitted_without
from edream.diagnosis.candidates import Candidate
from edream.diagnosis.decide import Round
from edream.diagnosis.descent import Fit
from edream.diagnosis.doubts import doubtful, in_place
from edream.diagnosis.exchange import LEFT, is_better
from edream.diagnosis.left_out import left_out_errors
from edream.diagnosis.problem import Problem
from edream.diagnosis.side_by_side import side_by_side
from edream.diagnosis.trials import Trial, judged


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
    for number, one in enumerate(out[:-1]):
        if one.taken is None or fit.rms <= LEFT * problem.floor:
            continue
        named = [r.taken.candidate for r in out if r.taken is not None]
        others = doubtful(problem, one, one.taken, named)
        put = partial(in_place, problem, fit, one.taken.candidate, behind=1.0)  # what comes no nearer is not better
        ends = list(side_by_side(put, others, problem.settings.threads))
        done(1)
        if not ends:
            continue
        errors = left_out_errors(problem, refitted_without(problem, fit, one.taken.candidate))
        old = judged(problem, fit, errors, one.taken)
        beside = [(judged(problem, end, errors, other), other) for end, other in zip(ends, others, strict=True)]
        better = [pair for pair in beside if passes(problem, pair[0]) and is_better(problem, pair[0], old)]
        if better:
            new, alone = max(better, key=lambda pair: pair[0].closed)
            fit, out[number] = new.fit, replace(one, taken=alone)
            out[-1] = asked_beside(problem, fit, out[-1], alone, [r.taken.candidate for r in out if r.taken is not None])
    return fit, out


def asked_beside(problem: Problem, fit: Fit, last: Round, other: Trial, named: Sequence[Candidate]) -> Round:
    """The last round beside another earlier name: what its own name could not be told from is put in its place again."""
    assert last.taken is not None
    rivals = doubtful(problem, last, last.taken, named)
    ends = side_by_side(partial(in_place, problem, fit, last.taken.candidate), rivals, problem.settings.threads)
    again = [judged(problem, end, other.errors, rival) for end, rival in zip(ends, rivals, strict=True)]
    own = judged(problem, fit, other.errors, last.taken)
    trials = sorted([own, *again], key=lambda t: -t.closed)
    return replace(last, before=other.fit, errors=other.errors, trials=trials, taken=own)
