"""Where a search begins."""

from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
from jaxtyping import Float

from edream.core.parameters import targets_in
from edream.sim.scales import position_gain, strongest

LESS = (1.0, 0.3, 0.1, 0.03, 0.01)  # of the published dry friction, and of the published gain
STIFF = 0.02  # rad (m) of error
ENOUGH = 6  # windows
CLEARLY = 0.5  # of the squared error: a lower gain that leaves more is no better place to begin


def beginning(objective: Any) -> Float[np.ndarray, "P"]:
    """The published numbers, with a lower gain and less dry friction on joints whose recordings are clearly nearer to that.

    Some models are published with servos so stiff that they only know all one way and all the other: there recordings of a soft
    servo ask for no number more than for another, and no descent leaves. For these alone a lower gain is looked at, and with it the
    square root of the damping, which damps a joint as well as before. Some models are published with a friction that their servos
    can hardly overcome: from there every search ends in the valley of servos that could, all torques of a joint too large by one
    factor.

    Args:
        objective: an `Objective`, or what stands in its place.
    """
    space, start, less = objective.simulated.space, objective.simulated.space.start(), np.array(LESS)[:, None]
    model, joints = objective.simulated.robot.model, [targets_in(name) for name in space.names]
    gain, damping, friction = (
        np.array([name.startswith(kind) for name in space.names]) for kind in ("servo_gain.", "viscous.damping", "coulomb.")
    )
    servos = set[str]().union(*(own for own, one in zip(joints, gain, strict=True) if one))
    hard = {joint for joint in servos if all_or_nothing(model, joint)}
    stiff = np.array([not hard.isdisjoint(own) for own in joints])
    if (gain & stiff).any():
        few = some(objective)
        softer = np.where(gain & stiff, less * start, np.where(damping & stiff, np.sqrt(less) * start, start))
        start = nearest(few, softer, CLEARLY)
        objective.simulations += few.simulations
    return nearest(objective, np.where(friction, less * start, start), 1.0) if friction.any() else start


def all_or_nothing(model: mujoco.MjModel, joint: str) -> bool:
    """Whether a servo reaches its torque limit [N m] at an error of 0.02 rad (m), so that it mostly stands there."""
    return strongest(model, joint) < STIFF * position_gain(model, joint)


def some(objective: Any) -> Any:
    """The objective on as many of its windows as show how stiff a servo is, evenly chosen."""
    chosen = np.unique(np.linspace(0, len(objective.windows) - 1, ENOUGH).round().astype(int))
    return replace(objective, windows=[objective.windows[one] for one in chosen], simulations=0)


def nearest(objective: Any, starts: Float[np.ndarray, "S P"], clearly: float) -> Float[np.ndarray, "P"]:
    """Of each parameter the value of the set that leaves its joints least; the first set's where none leaves so much less.

    Args:
        clearly: of the squared error that the first set leaves.
    """
    space, acts = objective.simulated.space, objective.acts_on
    low, high = space.from_unit(np.zeros(len(space))), space.from_unit(np.ones(len(space)))
    starts = np.clip(starts, low, high)
    squares = (objective.residuals(starts).reshape(len(starts), -1, acts.shape[1]) ** 2).sum(axis=1) @ acts.T.astype(float)
    best = squares.argmin(axis=0)
    each = np.arange(len(space))
    return starts[np.where(squares[best, each] < clearly * squares[0], best, 0), each]
