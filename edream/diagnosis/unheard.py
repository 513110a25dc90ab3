"""Effects that first looks passed over, where none of those that they liked stands."""

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float

from edream.diagnosis.descent import Fit
from edream.diagnosis.problem import Problem
from edream.diagnosis.trials import Trial, overlooked, try_boldly


def with_unheard(
    problem: Problem,
    fit: Fit,
    errors: Float[np.ndarray, "M"],
    trials: Sequence[Trial],
    done: Callable[[int], object] = lambda n: None,
) -> list[Trial]:
    """The trials, and every effect that was not tried on the joint that is off most.

    Where what passes on motions left out does not stand at the end of its search (its interval reaches its absence, or it sits at a
    bound), it stood in for what is missing: play in a gear seems to close much of a gap that is friction around standstill.

    Args:
        fit: the model without any of them.
        errors: on motions left out [rad^2], (M,), without any of them.
        trials: what was tried.
        done: called with how many units of work are finished.
    """
    tried = {one.candidate for one in trials}
    others = [one for one in overlooked(problem, fit, []) if one.candidate not in tried]
    return sorted([*trials, *try_boldly(problem, fit, errors, others, done)], key=lambda t: -t.closed)
