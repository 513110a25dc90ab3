"""Resistance proportional to speed."""

from collections.abc import Sequence
from dataclasses import replace

import mujoco
import numpy as np

from edream.core.effect import Effect, Fields, Values, joint_index
from edream.core.parameters import Parameter
from edream.sim.scales import BANDWIDTH, largest, position_gain
from edream.sim.servo import damping_inside, merge_damping, share_damping


def damping(model: mujoco.MjModel, targets: Sequence[str]) -> Parameter:
    """The damping of a joint and its servo together [N m s/rad], as published, or guessed from the servo's gain."""
    index = joint_index(model, targets[0])
    nominal = float(model.dof_damping[index["drive"]] - model.actuator_biasprm[index["actuator"], 2])
    guess = 0.0 if nominal > 0.0 else position_gain(model, targets[0]) / BANDWIDTH
    high = max(10.0 * nominal, 10.0 * guess, largest(model, targets))
    start = float(np.clip(max(nominal, guess), high * 1e-4, high))
    return Parameter("damping", "N m s/rad", high * 1e-4, high, start, scale="log", guessed=nominal <= 0.0)


def doses(model: mujoco.MjModel, targets: Sequence[str]) -> tuple[dict[str, float], ...]:
    """A little less damping and a little more [N m s/rad]."""
    start = damping(model, targets).start
    return ({"damping": 0.7 * start}, {"damping": 1.4 * start})


class SharedViscous(Effect):
    """The same as `Viscous`, and how much of it is the servo's: within its torque limit, which motions that reach the limit tell.

    Parameters: damping b [N m s/rad]; inside: the servo's share of it [1], about as published.
    """

    name = "viscous"
    summary = "another viscous friction"
    place = "joint"

    def parameters(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[Parameter, ...]:
        return (damping(model, targets), replace(damping_inside(model, targets), guessed=True))

    def probes(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[dict[str, float], ...]:
        return doses(model, targets)

    def write(self, fields: Fields, target: str, values: Values) -> None:
        merge_damping(fields, target, values["damping"])
        share_damping(fields, target, values["inside"])


class Viscous(Effect):
    """All resistance proportional to speed, the servo's own derivative term included.

        tau = -b qd

    Free motion shows only the sum of the joint's damping and the servo's derivative gain, so both are one number here, the joint's
    `damping`, and the servo's `kv` is 0. Where the servo's torque is limited, which its own damping counts towards, the servo keeps
    the share that it has as published. `derivative_gain` splits them where torque was switched off.
    Parameter: damping b [N m s/rad], absolute. Source: Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 30(7), 1994.
    """

    name = "viscous"
    summary = "another viscous friction"
    place = "joint"
    confusable = ("actuator_lag", "actuator_delay")
    finer = SharedViscous()

    def parameters(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[Parameter, ...]:
        return (damping(model, targets),)

    def probes(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[dict[str, float], ...]:
        return doses(model, targets)

    def write(self, fields: Fields, target: str, values: Values) -> None:
        merge_damping(fields, target, values["damping"])


ENTRY = Viscous()
