"""A servo that removes what error is left."""

from collections.abc import Sequence

import mujoco
import numpy as np

from edream.core.effect import Effect, Fields, Values, joint_index
from edream.core.parameters import Parameter
from edream.sim.servo import as_pid


class IntegralAction(Effect):
    """Integral term of the servo.

        tau = kp e - kv qd + ki integral(e dt),  e = u - q

    The sag under gravity creeps away after each move, and friction makes the joint hunt. Writes `ki` of MuJoCo's `pid` actuator,
    one activation that starts at 0. Parameter: ki [N m/(rad s)]. Source: MuJoCo XML reference, actuator/pid/ki.
    """

    name = "integral_action"
    summary = "an integral term of the servo"
    place = "joint"
    confusable = ("servo_gain", "coulomb")
    of_position_servo = True

    def parameters(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[Parameter, ...]:
        kp = -float(model.actuator_biasprm[joint_index(model, targets[0])["actuator"], 1])
        return (Parameter("ki", "N m/(rad s)", 0.0, 5.0 * kp, 0.0, absent=0.0),)

    def edit(self, spec: mujoco.MjSpec, target: str) -> None:
        actuator = as_pid(spec, target)
        law = np.array(actuator.gainprm)
        law[0] = 1e-9
        actuator.gainprm = law

    def write(self, fields: Fields, target: str, values: Values) -> None:
        fields["actuator_gainprm"][:, joint_index(fields.model, target)["actuator"], 0] = values["ki"]


ENTRY = IntegralAction()
