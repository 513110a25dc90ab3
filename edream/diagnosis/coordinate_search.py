"""Out of false valleys: where servos reach the limit of their torque, the error is rough over the usual numbers."""

import numpy as np
from jaxtyping import Float

from edream.core.parameters import targets_in
from edream.diagnosis.descent import Fit, begin, descend, own_rows
from edream.diagnosis.left_out import leaves_no_gap
from edream.diagnosis.problem import Problem
from edream.sim.objective import rms

STEPS = (-1.0, -2.0 / 3.0, -1.0 / 3.0, 1.0 / 3.0, 2.0 / 3.0, 1.0)  # standard deviations of a number's prior
LESS = 0.9  # of a joint's error: where more than that is left, the place is no other valley
ROUNDS = 3


def coordinate_search(problem: Problem, fit: Fit) -> Fit:
    """The fit, or a better one that was descended to from where one number of some joints is elsewhere.

    A servo that gives all it has one way or the other moves its joint by the moments at which it turns over, which jump as its
    numbers change: a descent ends in the first of many valleys. One number of a joint at a time is put up to a standard deviation
    away, that of all groups at once, since joints hardly matter to each other; each takes its best place.
    Source: coordinate search as in Kolda, Lewis, Torczon, SIAM Review 45(3), 2003, each place descended from.

    Args:
        problem: only the groups that `shared` says, whose servos reach the limit of their torque, are searched.
        fit: the end of a descent; stays as it is where it leaves no gap.
    """
    for _ in range(ROUNDS):
        place = None if leaves_no_gap(problem, fit) else best_along_coordinates(problem, fit)
        if place is None:
            break
        found = descend(begin(fit.objective, place), None, iterations=8)
        if found.rms >= LESS * fit.rms:
            return min(fit, found, key=lambda one: one.rms)
        fit = found
    return fit


def best_along_coordinates(problem: Problem, fit: Fit) -> Float[np.ndarray, "P"] | None:
    """The unit-box numbers with one of each group's moved where its joints' error is clearly less, (P,); None if it is nowhere."""
    space, spread = fit.space, fit.space.unit_prior()[1]
    columns = [[k for k, name in enumerate(space.names) if targets_in(name) == frozenset(group)] for group in problem.shared]
    moved = []
    for turn in range(max((len(own) for own in columns), default=0)):
        number = np.array([own[turn] for own in columns if turn < len(own) and np.isfinite(spread[own[turn]])], dtype=int)
        for step in STEPS:
            unit = fit.unit.copy()
            unit[number] = np.clip(unit[number] + step * spread[number], 0.0, 1.0)
            moved.append(unit)
    if not moved:
        return None
    residuals = fit.objective.residuals(space.from_unit(np.array(moved)))
    out, rows = fit.unit.copy(), own_rows(fit.objective, fit.residual)
    for own in columns:
        theirs = rows[:, own[0]]
        errors = [rms(residual[theirs]) for residual in residuals]
        best = int(np.argmin(errors))
        if errors[best] < LESS * rms(fit.residual[theirs]):
            out[own] = moved[best][own]
    return None if np.array_equal(out, fit.unit) else out
