"""Out of false valleys: where servos reach the limit of their torque, the error is rough over what a descent follows."""

from collections.abc import Sequence

import cma
import numpy as np
from jaxtyping import Float

from edream.core.parameters import targets_in
from edream.diagnosis.descent import Fit, begin, descend, own_rows
from edream.diagnosis.few import ENOUGH, thinned
from edream.diagnosis.left_out import ELSEWHERE, joint_errors, leaves_no_gap
from edream.diagnosis.problem import VISIBLE, Problem

POPULATION, GENERATIONS = 12, 30  # of each joint's search
PATIENCE = 16  # generations after which a search that has found nothing clearly better ends
WIDTH, WIDEST = 0.5, 0.15  # of a number's standard deviation, and of its range where that is less: how far apart places begin
LESS = 0.9  # of a joint's error: where more than that is left, the place is no other valley
ROUNDS = 2


def out_of_false_valleys(problem: Problem, fit: Fit) -> Fit:
    """The fit, or a better one that was descended to from where the numbers of some joints are elsewhere.

    A servo that gives all it has one way or the other moves its joint by the moments at which it turns over, which jump as its
    numbers change: a descent ends in the first of many valleys.

    Args:
        problem: only the groups that `shared` says, whose servos reach the limit of their torque, are searched.
        fit: the end of a descent; stays as it is where neither it nor one of these joints leaves a gap.
    """
    for _ in range(ROUNDS):
        place = better_place(problem, fit, groups_off(problem, fit))
        found = fit if place is None else descend(begin(fit.objective, place), None, iterations=8)
        if found.rms >= fit.rms:
            break
        fit = found
    return fit


def groups_off(problem: Problem, fit: Fit) -> list[tuple[str, ...]]:
    """The groups whose servos reach their limit and that are off by what can be seen; none where nothing is.

    What one joint is off by the mean over many hides.
    """
    errors = dict(zip(problem.joints, joint_errors(problem, fit), strict=True))
    most = {group: max(errors[joint] for joint in group) for group in problem.shared}
    if leaves_no_gap(problem, fit) and max(most.values(), default=0.0) <= ELSEWHERE * problem.floor:
        return []
    return [group for group, error in most.items() if error > (1.0 + VISIBLE) * problem.floor]


def better_place(problem: Problem, fit: Fit, groups: Sequence[tuple[str, ...]]) -> Float[np.ndarray, "P"] | None:
    """The unit-box numbers with those of some groups where their joints' error is clearly less, (P,); None if it is nowhere.

    Every group has a population of its own, on a few motions that stand for all; all are simulated at once, since joints hardly
    matter to each other.
    """
    if not groups:
        return None
    few, rng = thinned(fit, ENOUGH), np.random.default_rng([problem.settings.seed, 19])
    searches = [_Search(few, group, rng) for group in groups]
    for generation in range(GENERATIONS):
        if generation >= PATIENCE and not any(search.succeeds for search in searches):
            break
        units = np.tile(fit.unit, (POPULATION, 1))
        for search in searches:
            units[:, search.own] = search.asked()
        residuals = few.objective.residuals(fit.space.from_unit(units))
        for search in searches:
            search.told(units, residuals)
    out = fit.unit.copy()
    for search in searches:
        if search.succeeds:
            out[search.own] = search.best
    return None if np.array_equal(out, fit.unit) else out


class _Search:
    """A population of places for the numbers of one group's joints.

    Source: Hansen, The CMA Evolution Strategy: A Tutorial, 2016; package `cma`.
    """

    def __init__(self, fit: Fit, group: tuple[str, ...], rng: np.random.Generator) -> None:
        self.own = np.array([k for k, name in enumerate(fit.space.names) if targets_in(name) == frozenset(group)])
        self.rows, self.scale = own_rows(fit.objective, fit.residual)[:, self.own[0]], fit.scale
        self.centre, self.spread = (one[self.own] for one in fit.space.unit_prior())
        self.best = fit.unit[self.own]
        self.first = self.least = float(self._costs(fit.unit[None], fit.residual[None])[0])
        options = {"bounds": [0.0, 1.0], "popsize": POPULATION, "verbose": -9, "seed": np.nan}
        drawn = {"randn": lambda *shape: rng.standard_normal(shape), "CMA_stds": WIDTH * np.minimum(self.spread, WIDEST)}
        self._strategy = cma.CMAEvolutionStrategy(self.best, 1.0, options | drawn)

    @property
    def succeeds(self) -> bool:
        """Whether a place was found that is clearly better than the first."""
        return self.least < LESS**2 * self.first

    def asked(self) -> Float[np.ndarray, "N own"]:
        self._points = self._strategy.ask()
        return np.array(self._points)

    def told(self, units: Float[np.ndarray, "N P"], residuals: Float[np.ndarray, "N R"]) -> None:
        costs = self._costs(units, residuals)
        self._strategy.tell(self._points, costs.tolist())
        if costs.min() < self.least:
            self.least, self.best = float(costs.min()), units[int(costs.argmin()), self.own]

    def _costs(self, units: np.ndarray, residuals: np.ndarray) -> Float[np.ndarray, "N"]:
        away = (units[:, self.own] - self.centre) / self.spread
        return (residuals[:, self.rows] ** 2).sum(axis=1) / self.scale**2 + (away**2).sum(axis=1)
