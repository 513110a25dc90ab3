"""Another way: where names lead no further and a clear gap is left, the last one gives way to what it was not told from."""

from collections.abc import Callable, Sequence
from dataclasses import replace

from edream.diagnosis.backward import stands
from edream.diagnosis.decide import Round
from edream.diagnosis.descent import Fit, polish
from edream.diagnosis.doubts import doubtful
from edream.diagnosis.ends import arrived
from edream.diagnosis.forward import forward
from edream.diagnosis.left_out import is_clear
from edream.diagnosis.problem import Problem
from edream.diagnosis.trials import predicted

WAYS = 2  # of what the last name was not told from


def by_another_way(
    problem: Problem, fit: Fit, rounds: Sequence[Round], done: Callable[[str, int], object] = lambda text, n: None
) -> tuple[Problem, Fit, list[Round]]:
    """What `forward` found, or what it finds from a rival of its last name, where only that leaves no clear gap in the end.

    Two effects on one joint look like a third as long as they are not both known: a limit of the setpoint's speed beside friction
    at a place like a motor that is too weak, beside which nothing more was found.

    Args:
        problem: with the steps that `forward` took.
        fit: its end.
        rounds: its rounds.
        done: called with what is under way and how many units of it are finished.

    Returns:
        What `forward` returns.
    """
    names = [one.taken for one in rounds if one.taken is not None]
    if not names or rounds[-1].taken is not None or not is_clear(problem, rounds[-1].errors):
        return problem, fit, list(rounds)
    last = next(i for i, one in enumerate(rounds) if one.taken is names[-1])
    for rival in doubtful(problem, rounds[last], names[-1], [t.candidate for t in names])[:WAYS]:
        start = polish(arrived(problem, rounds[last].before, rival))
        if not stands(problem, rival.candidate, start):
            continue
        sharper, end, found = forward(problem, start, done, [*rounds[:last], replace(rounds[last], taken=rival)])
        if not is_clear(sharper, predicted(sharper, end, found[-1].taken)):
            return sharper, end, found
    return problem, fit, list(rounds)
