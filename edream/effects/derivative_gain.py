"""Derivative gain of the servo."""

from collections.abc import Sequence

import mujoco
import numpy as np

from edream.core.effect import Effect, Fields, Values, joint_index
from edream.core.parameters import Parameter
from edream.sim.scales import largest
from edream.sim.servo import part_damping


class DerivativeGain(Effect):
    """The servo's own damping, which acts only while torque is on.

        tau = kp (u - q) - kv qd

    Told from `viscous` only where torque was switched off: the joint then falls against its own damping alone. Where both are
    placed, `viscous` is the joint's damping and this the servo's. Writes `biasprm[2]`.
    Parameter: kv [N m s/rad], absolute. Source: MuJoCo XML reference, actuator/position.
    """

    name = "derivative_gain"
    summary = "another derivative gain of the servo"
    place = "joint"
    confusable = ("viscous", "actuator_lag", "actuator_delay")
    of_position_servo = True
    late = 1

    def parameters(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[Parameter, ...]:
        index = joint_index(model, targets[0])
        nominal = -float(model.actuator_biasprm[index["actuator"], 2])
        high = max(10.0 * nominal, largest(model, targets))
        return (Parameter("kv", "N m s/rad", 0.0, high, float(np.clip(nominal, 0.0, high)), absent=0.0),)

    def write(self, fields: Fields, target: str, values: Values) -> None:
        part_damping(fields, target, values["kv"])


ENTRY = DerivativeGain()
