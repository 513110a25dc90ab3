"""Two effects at once: where nothing is named and a clear gap is left, the best candidate is looked at with another one beside it.

Of two effects that show on one joint each may close less than half of what both do, and a formula more than either: a servo with a
dead zone closed a third on a base that leans, which closed nothing alone.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from edream.diagnosis.astray import screen_twice
from edream.diagnosis.backward import stands
from edream.diagnosis.decide import Round
from edream.diagnosis.descent import Fit, polish
from edream.diagnosis.ends import arrived
from edream.diagnosis.forward import CLEARLY, forward
from edream.diagnosis.left_out import is_clear, left_out_errors
from edream.diagnosis.problem import Problem
from edream.diagnosis.trials import predicted, try_best


def by_two(
    problem: Problem, fit: Fit, rounds: Sequence[Round], done: Callable[[str, int], object] = lambda text, n: None
) -> tuple[Problem, Fit, list[Round]]:
    """What `forward` found, or, where it named nothing, what it finds from its best candidate on, if only that leaves no clear gap.

    It goes on from there only where a further candidate promises to leave clearly less than the best one, and than a formula does.

    Takes and returns what `edream.diagnosis.another_way.by_another_way` does.
    """
    first = rounds[0]
    left = first.errors if first.formula is None else first.formula.errors
    best = max((t for t in first.trials if t.sure), key=lambda t: t.closed, default=None)
    if len(rounds) > 1 or first.taken is not None or best is None or not is_clear(problem, left):
        return problem, fit, list(rounds)
    start = polish(arrived(problem, first.before, best))
    if stands(problem, best.candidate, start) and shows_more(problem, start, left, done):
        sharper, end, found = forward(problem, start, done, [replace(first, taken=best, formula=None)])
        if not is_clear(sharper, predicted(sharper, end, found[-1].taken)):
            return sharper, end, found
    return problem, fit, list(rounds)


def shows_more(problem: Problem, fit: Fit, left: Float[np.ndarray, "M"], done: Callable[[str, int], object]) -> bool:
    """Whether some candidate beside a fit surely leaves clearly less than it does, and than `left` [rad^2], (M,)."""
    errors = left_out_errors(problem, fit)
    scored = screen_twice(problem, fit, lambda n: done("screening", n))
    trials = try_best(problem, fit, errors, scored, lambda n: done("refitting", n))
    least, floor = min(left.mean(), errors.mean()), problem.floor**2
    return any(t.sure and t.errors.mean() - floor < CLEARLY * (least - floor) for t in trials)
