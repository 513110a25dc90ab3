"""How often something succeeded, and how well that is known."""

from collections.abc import Sequence
from dataclasses import dataclass

from scipy.stats import binomtest

from edream.core.errors import EdreamError


@dataclass(frozen=True)
class Rate:
    """A share of trials.

    Attributes:
        successes, trials: counts.
        share: successes / trials.
        interval: Wilson's interval at 95 %.
    """

    successes: int
    trials: int
    share: float
    interval: tuple[float, float]


def rate(successes: Sequence[bool], level: float = 0.95) -> Rate:
    """Success rate with Wilson's interval. Source: Wilson, JASA 22(158), 1927.

    Raises:
        EdreamError: there are no trials.
    """
    if not len(successes):
        raise EdreamError("There are no trials to take a rate of; expected at least 1.")
    count, trials = int(sum(bool(one) for one in successes)), len(successes)
    found = binomtest(count, trials).proportion_ci(level, method="wilson")
    return Rate(count, trials, count / trials, (float(found.low), float(found.high)))


def apart(a: Rate, b: Rate) -> bool:
    """Whether two intervals do not overlap."""
    return a.interval[0] > b.interval[1] or b.interval[0] > a.interval[1]


@dataclass(frozen=True)
class Paired:
    """Two policies on the same starts, of which those count that only one of them did.

    Attributes:
        first, second: starts that only the first did, and only the second.
        chance: how likely so uneven a split is where both are equally good (exact, two-sided).
    """

    first: int
    second: int
    chance: float


def paired(first: Sequence[bool], second: Sequence[bool]) -> Paired:
    """Compare policies start by start, which tells them apart sooner than their rates do. Source: McNemar, Psychometrika 12, 1947.

    Args:
        first, second: outcomes of the same starts in the same order.
    """
    one = sum(bool(a) and not b for a, b in zip(first, second, strict=True))
    two = sum(bool(b) and not a for a, b in zip(first, second, strict=True))
    return Paired(one, two, float(binomtest(one, one + two).pvalue) if one + two else 1.0)
