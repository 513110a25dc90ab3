"""A few motions that stand for all: there first looks are cheap, and what is missing shows."""

from collections.abc import Hashable, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from edream.diagnosis.descent import Fit
from edream.sim.mass import HAND_WEIGHT

ENOUGH = 20.0  # s of motion that a score test and first steps need
NEARLY = 0.97  # of so much motion is enough: recordings of 10 s end a little before
TINY = 1e-300  # keeps shares of no error at all finite


def thinned(fit: Fit, seconds: float) -> Fit:
    """The fit on as few of its motions as last some `seconds` together, and stand for all: there a missing effect shows."""
    windows = fit.objective.windows
    squares = np.array([(part**2).sum(axis=0) for part in fit.objective.per_window(fit.residual)])
    kept = representative(squares, np.array([float(w.times[-1]) for w in windows]), seconds, set_ups(fit))
    if len(kept) == len(windows):
        return fit
    return on_motions(fit, kept)


def on_motions(fit: Fit, kept: Sequence[int]) -> Fit:
    """The fit on some of its motions, by their numbers."""
    rows = np.isin(fit.objective.owner, kept)
    offset = None if fit.objective.offset is None else fit.objective.offset[rows]
    windows = [fit.objective.windows[i] for i in kept]
    objective = replace(fit.objective, windows=windows, simulations=0, offset=offset)
    return replace(fit, objective=objective, residual=fit.residual[rows], jacobian=fit.jacobian[rows])


def set_ups(fit: Fit) -> list[tuple[float | None, ...]]:
    """How the robot was set up for each motion: the conditions that change what is simulated."""
    scaled = {one.condition for place in fit.objective.simulated.placements for one in (place.scaled or {}).values()}
    names = sorted(scaled | {HAND_WEIGHT})
    return [tuple(window.episode.conditions.get(name) for name in names) for window in fit.objective.windows]


def representative(
    squares: Float[np.ndarray, "M J"], lasts: Float[np.ndarray, "M"], seconds: float, kinds: Sequence[Hashable] = ()
) -> list[int]:
    """Numbers of the motion that is off most, and of others beside it, among those that are off more than half of all are.

    First of all that of each kind: what one set-up of the robot leaves open another tells.

    Each time the one whose error makes the joints' shares of it most like those in all motions: the few that are off most may be
    off by something of their own, on one joint, and what is on all joints alike goes unseen in them.

    Args:
        squares: sum of squared errors [rad^2] of each joint in each motion.
        lasts: how long each motion is [s].
        seconds: how much motion is enough.
        kinds: which set-up each motion was made under; all alike where none is said.
    """
    shares = squares.sum(axis=0) / max(float(squares.sum()), TINY)
    order = np.argsort(-squares.sum(axis=1), kind="stable").tolist()
    kept = list({kinds[i] if kinds else 0: i for i in reversed(order)}.values())
    left = [i for i in order if i not in kept]
    while left and lasts[kept].sum() < NEARLY * seconds:
        near = left[: max(len(lasts) // 2 - len(kept), 1)]
        beside = squares[kept].sum(axis=0) + squares[near]
        unlike = np.abs(beside / np.maximum(beside.sum(axis=1, keepdims=True), TINY) - shares).sum(axis=1)
        kept.append(near[int(np.argmin(unlike))])
        left.remove(kept[-1])
    return sorted(kept)
