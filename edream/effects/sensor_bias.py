"""Measurements that count from another zero than the servo."""

from collections.abc import Sequence

import mujoco

from edream.core.effect import Effect, Fields, Values, joint_index
from edream.core.errors import EdreamError
from edream.core.parameters import Parameter
from edream.sim.servo import is_pid


class SensorBias(Effect):
    """Zero of the recorded positions: the servo holds its own reading, the recording shows another.

        q_measured = q + b,  tau = kp (u - q) - kv qd = kp (u + b - q_measured) - kv qd

    The joint stands b from its command at rest, whatever its friction, weight or direction. Writes `qpos0` (MJCF: joint `ref`) and
    the servo's constant `biasprm[0]`, so that the model counts as the recording does. Parameter: angle b [rad].
    Source: MuJoCo XML reference, body/joint/ref and actuator/general/biasprm.
    """

    name = "sensor_bias"
    summary = "a constant bias of the measurements"
    place = "joint"
    confusable = ("constant_torque", "encoder_offset", "gravity_tilt", "asymmetric_coulomb")
    of_type = False
    of_position_servo = True
    late = 2

    def parameters(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[Parameter, ...]:
        return (Parameter("angle", "rad", -0.35, 0.35, 0.0, absent=0.0, spread=0.1),)

    def write(self, fields: Fields, target: str, values: Values) -> None:
        index = joint_index(fields.model, target)
        actuator, bias = index["actuator"], values["angle"]
        if is_pid(fields.model, actuator):
            raise EdreamError(f"Servo of joint {target!r} is a PID, whose error MuJoCo cannot shift; drop sensor_bias there.")
        for qpos in {index["qpos"], index["drive_qpos"]}:
            fields["qpos0"][:, qpos] = fields["qpos0"][:, qpos] + bias
        law = fields["actuator_biasprm"]
        law[:, actuator, 0] -= law[:, actuator, 1] * bias


ENTRY = SensorBias()
