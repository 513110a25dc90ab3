"""What is looked for where no candidate closes half of a real gap: what no descent finds, and what usual numbers hide."""

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float

from edream.diagnosis.backward import passes
from edream.diagnosis.descent import Fit
from edream.diagnosis.left_out import HALF, is_real, worst_joint
from edream.diagnosis.nearest import begun_in_all_strengths
from edream.diagnosis.problem import Problem
from edream.diagnosis.rough import rough_candidates, searched
from edream.diagnosis.screen import Scored
from edream.diagnosis.starts import in_all_strengths_beside_published
from edream.diagnosis.trials import HOPELESS, Trial, best_of_each, finished, judged, on_few


def with_rough(
    problem: Problem,
    fit: Fit,
    errors: Float[np.ndarray, "M"],
    trials: Sequence[Trial],
    done: Callable[[int], object] = lambda n: None,
) -> list[Trial]:
    """The trials; where none that passes closes as much as half of a real gap, also the effects that no descent finds."""
    if not is_wanting(problem, errors, trials):
        return list(trials)
    more = []
    for candidate in rough_candidates(problem, fit):
        if (found := searched(problem, fit, candidate)) is not None:
            more.append(judged(problem, found, errors, Scored(candidate, {}, 0.0)))
        done(1)
    others = [t for t in trials if t.candidate not in [m.candidate for m in more]]
    return sorted([*others, *more], key=lambda t: -t.closed)


def with_put_back(
    problem: Problem,
    fit: Fit,
    errors: Float[np.ndarray, "M"],
    trials: Sequence[Trial],
    done: Callable[[int], object] = lambda n: None,
) -> list[Trial]:
    """The trials; where none that passes closes as much as half of a real gap, also what hides in usual numbers.

    It is begun in all strengths beside the published numbers of the joint that is off most. Where those have made up for it, the
    score test sees nothing of it: a dead zone moves as more dry friction does.
    """
    if not is_wanting(problem, errors, trials):
        return list(trials)
    few = on_few(problem, fit)
    begun = begun_in_all_strengths(problem, few, [(worst_joint(problem, few),)], in_all_strengths_beside_published)
    gains = [1.0 - (near.rms / few.rms) ** 2 for near, _ in begun]
    least = max(HOPELESS * max(gains, default=0.0), 0.0)
    hopeful = [pair for pair, gain in zip(begun, gains, strict=True) if gain > least]
    more = []
    for trial in finished(problem, fit, errors, hopeful):
        more.append(trial)
        done(1)
    return best_of_each([*trials, *more])


def is_wanting(problem: Problem, errors: Float[np.ndarray, "M"], trials: Sequence[Trial]) -> bool:
    """Whether no candidate that passes closes as much as half of a real gap."""
    best = next((t for t in trials if passes(problem, t)), None)
    left = errors if best is None else best.errors
    return is_real(problem, left) and (best is None or best.closed < HALF)
