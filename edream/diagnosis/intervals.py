"""Intervals of numbers that go together, in a box that none of them can leave."""

import numpy as np
from jaxtyping import Float
from scipy.optimize import lsq_linear

SURE = 1.96  # standard deviations to either side: a 95 % interval
MOST_STEPS = 12  # on the way to an end
NEARLY = 1e-4  # of the level: so near is there
SINGULAR = 1e-9  # of a variance: less is none, where numbers go together wholly


def within_box(
    unit: Float[np.ndarray, "P"], covariance: Float[np.ndarray, "P P"], level: float = SURE
) -> tuple[Float[np.ndarray, "P"], Float[np.ndarray, "P"]]:
    """How far each number of the unit box can go, the others going with it inside theirs.

    The ends of number i are those of

        { x_i : (x - u)' C^-1 (x - u) <= level^2, 0 <= x <= 1 },

    u_i +- level sqrt(C_ii) where no other number is stopped on the way. One that is tells more of those that it goes with: less
    play in a gear would do as well only beside a servo that follows the link by less than nothing.

    Args:
        unit: u, the numbers found.
        covariance: C.
        level: standard deviations.

    Returns:
        Lower and upper ends, (P,) each.
    """
    spread = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    ends = [np.clip(unit + side * level * spread, 0.0, 1.0) for side in (-1.0, 1.0)]
    known = np.flatnonzero(spread > 0.0)
    if len(known) < 2:
        return ends[0], ends[1]
    s, u = spread[known], unit[known]
    together = covariance[np.ix_(known, known)] / np.outer(s, s)
    room = np.stack([-u / s, (1.0 - u) / s], axis=1)
    eigen, vectors = np.linalg.eigh(together)
    root = vectors.T / np.sqrt(np.maximum(eigen, SINGULAR))[:, None]
    for end in ends:
        for i, number in enumerate(known):
            far = (end[number] - unit[number]) / spread[number]
            gone = spread[number] * _reached(i, far, together[:, i], root, room, level)
            end[number] = np.clip(unit[number] + gone, 0.0, 1.0)
    return ends[0], ends[1]


def _reached(
    i: int, far: float, going: Float[np.ndarray, "K"], root: Float[np.ndarray, "K K"], room: Float[np.ndarray, "K 2"], level: float
) -> float:
    """How far number i gets on its way to `far`, all in standard deviations; `going` says how far the others go with it."""
    others = np.arange(len(going)) != i
    if np.all((far * going >= room[:, 0] - SINGULAR)[others] & (far * going <= room[:, 1] + SINGULAR)[others]):
        return far
    low, high = np.minimum(room[others, 0], 0.0) - SINGULAR, np.maximum(room[others, 1], 0.0) + SINGULAR

    way = far
    for _ in range(MOST_STEPS):  # Newton's, from outside: the distance is convex along the way
        nearest = lsq_linear(root[:, others], -root[:, i] * way, bounds=(low, high), method="bvls")
        rest = root[:, others] @ nearest.x + root[:, i] * way
        distance = float(np.linalg.norm(rest))  # from u, of the nearest place in the box that has gone so far
        if distance <= (1.0 + NEARLY) * level:
            break
        way -= (distance - level) * distance / float(root[:, i] @ rest)
    return way
