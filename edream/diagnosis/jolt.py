"""Out of false valleys: where servos reach the limit of their torque, the error is rough over the usual numbers."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from edream.core.parameters import targets_in
from edream.diagnosis.descent import Fit, begin, descend, own_rows
from edream.sim.objective import rms

JOLTS = (-1.0, -2.0 / 3.0, -1.0 / 3.0, 1.0 / 3.0, 2.0 / 3.0, 1.0)  # standard deviations of a number's prior
NOTED = 0.9  # of a joint's error: where more than that is left, the place is no other valley
ROUNDS = 3


def jolted(fit: Fit, groups: Sequence[tuple[str, ...]]) -> Fit:
    """The fit, or a better one that begins where one number of some groups of joints is elsewhere.

    A servo that gives all it has one way or the other moves its joint by the moments at which it turns over, which jump as its
    numbers change: a descent ends in the first of many valleys. One number of a joint at a time is put up to a standard deviation
    away, that of all groups at once, since joints hardly matter to each other; each takes its best place.

    Args:
        fit: the end of a descent.
        groups: joints that share their numbers, each tuple one group, whose servos reach the limit of their torque.
    """
    for _ in range(ROUNDS):
        place = elsewhere(fit, groups)
        if place is None:
            break
        found = descend(begin(fit.objective, place), None, iterations=8)
        if found.rms >= NOTED * fit.rms:
            return min(fit, found, key=lambda one: one.rms)
        fit = found
    return fit


def elsewhere(fit: Fit, groups: Sequence[tuple[str, ...]]) -> Float[np.ndarray, "P"] | None:
    """The unit-box numbers with one of each group's moved where its joints' error is clearly less, (P,); None if it is nowhere."""
    space, spread = fit.space, fit.space.unit_prior()[1]
    columns = {group: [k for k, name in enumerate(space.names) if targets_in(name) == frozenset(group)] for group in groups}
    moved = []
    for turn in range(max((len(own) for own in columns.values()), default=0)):
        number = np.array([own[turn] for own in columns.values() if turn < len(own) and np.isfinite(spread[own[turn]])], dtype=int)
        for jolt in JOLTS:
            unit = fit.unit.copy()
            unit[number] = np.clip(unit[number] + jolt * spread[number], 0.0, 1.0)
            moved.append(unit)
    if not moved:
        return None
    residuals = fit.objective.residuals(space.from_unit(np.array(moved)))
    out, rows = fit.unit.copy(), own_rows(fit.objective, fit.residual)
    for own in columns.values():
        theirs = rows[:, own[0]]
        errors = [rms(residual[theirs]) for residual in residuals]
        best = int(np.argmin(errors))
        if errors[best] < NOTED * rms(fit.residual[theirs]):
            out[own] = moved[best][own]
    return None if np.array_equal(out, fit.unit) else out
