"""A joint that turns more, or less, than it is told."""

from collections.abc import Sequence

import mujoco

from edream.core.effect import Effect, Fields, Values, joint_index
from edream.core.errors import EdreamError
from edream.core.parameters import Parameter
from edream.sim.servo import is_pid


class GearRatio(Effect):
    """Commands scaled on their way to the motor: another gear ratio, or a wrong unit of the servo.

        tau = kp (r u - q) - kv qd

    The error grows with the distance from zero, whatever the load. Writes `gainprm[0]` = r kp beside `biasprm[1]` = -kp.
    Parameter: ratio r [1]. Source: MuJoCo computation chapter, actuation model.
    """

    name = "gear_ratio"
    summary = "another gear ratio"
    place = "joint"
    confusable = ("servo_gain", "encoder_offset", "spring")
    of_position_servo = True
    late = 1

    def parameters(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[Parameter, ...]:
        return (Parameter("ratio", "1", 0.7, 1.4, 1.0, absent=1.0),)

    def probes(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[dict[str, float], ...]:
        return ({"ratio": 1.01},)

    def write(self, fields: Fields, target: str, values: Values) -> None:
        actuator = joint_index(fields.model, target)["actuator"]
        if is_pid(fields.model, actuator):
            raise EdreamError(f"Servo of joint {target!r} is a PID, whose command MuJoCo cannot scale; drop gear_ratio there.")
        fields["actuator_gainprm"][:, actuator, 0] = -fields["actuator_biasprm"][:, actuator, 1] * values["ratio"]


ENTRY = GearRatio()
