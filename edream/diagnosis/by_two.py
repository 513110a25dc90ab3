"""Two effects at once: where nothing is named and a clear gap is left, the best candidate is looked at with another one beside it.

Of two effects that show on one joint each may close less than half of what both do, and a formula more than either: a servo with a
dead zone closed a third on a base that leans, which closed nothing alone. From far off, both are looked for together first: a motor
that is too weak led a spring beside it into a false valley, and closed nothing alone.
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
from edream.diagnosis.left_out import far_off, gap_above_floor, is_clear, left_out_errors
from edream.diagnosis.problem import Problem
from edream.diagnosis.shooting import both_at_once
from edream.diagnosis.trials import Trial, predicted, try_best

HARDLY = 0.001  # of the squared gap above the floor: two effects that leave no more of a large one may leave some that is clear


def by_two(
    problem: Problem, fit: Fit, rounds: Sequence[Round], done: Callable[[str, int], object] = lambda text, n: None
) -> tuple[Problem, Fit, list[Round]]:
    """What `forward` found, or, where it named nothing, what it finds from two effects found at once or from its best candidate on.

    It goes on from there only where both promise to leave clearly less than the best one, and than a formula does, and that is the
    answer only if it leaves no clear gap; two found at once may leave hardly any of a large one.

    Takes and returns what `edream.diagnosis.another_way.by_another_way` does.
    """
    first = rounds[0]
    left = first.errors if first.formula is None else first.formula.errors
    if len(rounds) > 1 or first.taken is not None or not is_clear(problem, left):
        return problem, fit, list(rounds)
    pair = both_at_once(problem, first.before, first.errors) if far_off(problem, first.before) else None
    if pair is not None and leaves_clearly_less(problem, pair.second, left):
        one = [replace(first, taken=pair.first, formula=None)]
        sharper, end, found = forward(pair.problem, pair.first.fit, done, one, [pair.second])
        errors, most = predicted(sharper, end, found[-1].taken), HARDLY * gap_above_floor(problem, first.errors)
        if not is_clear(sharper, errors) or gap_above_floor(problem, errors) <= most:
            return sharper, end, found
    best = max((t for t in first.trials if t.sure), key=lambda t: t.closed, default=None)
    if best is None:
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
    least = left if left.mean() < errors.mean() else errors
    return any(leaves_clearly_less(problem, trial, least) for trial in trials)


def leaves_clearly_less(problem: Problem, trial: Trial, errors: Float[np.ndarray, "M"]) -> bool:
    """Whether a candidate surely leaves clearly less than `errors` [rad^2], (M,)."""
    floor = problem.floor**2
    return trial.sure and bool(trial.errors.mean() - floor < CLEARLY * (errors.mean() - floor))
