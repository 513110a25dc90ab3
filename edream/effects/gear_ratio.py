"""A gear that is not the one in the model."""

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from edream.core.effect import MEASURED_SUFFIX, Effect, Fields, Values, joint_index
from edream.core.errors import EdreamError
from edream.core.parameters import Parameter
from edream.sim.servo import is_pid, read_by_sensors, servo

FARTHEST, LEAST = 0.4, 0.01  # more or less than one; of what gears and units are usually off by


class GearRatio(Effect):
    """Commands and readings that count other angles than the joint's own: another gear, or a wrong unit of servo or encoder.

        tau = kp (r u - s q) - kv qd,  q_measured = s q

    With r alone the joint turns more, or less, than it is told, whatever the load. With s alone it is where its encoder says it
    should be, but not where the model has it, which only weight and inertia tell. Writes the servo's `gear` (s) and gains, and
    reads the joint by an `actuatorpos` sensor `<joint>_measured`; a replay begins at q = q_measured / s. Parameters: ratio r
    [1], encoder s [1]. Source: MuJoCo computation chapter, actuation model; MuJoCo XML reference, actuator/general/gear.
    """

    name = "gear_ratio"
    summary = "another gear ratio"
    place = "joint"
    confusable = ("servo_gain", "armature", "encoder_offset", "spring", "payload", "constant_torque")
    shifts_links = True
    of_position_servo = True
    late = 2

    def parameters(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[Parameter, ...]:
        low, high = 1.0 - FARTHEST, 1.0 + FARTHEST
        return (Parameter("ratio", "1", low, high, 1.0, absent=1.0), Parameter("encoder", "1", low, high, 1.0, absent=1.0))

    def probes(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[dict[str, float], ...]:
        return ({"ratio": 1.01, "encoder": 1.0}, {"ratio": 1.0, "encoder": 1.03}, {"ratio": 1.0, "encoder": 0.97})

    def is_usual(self, values: Mapping[str, float]) -> bool:
        return max(abs(values["ratio"] - 1.0), abs(values["encoder"] - 1.0)) >= LEAST

    def edit(self, spec: mujoco.MjSpec, target: str) -> None:
        read_by_sensors(spec)
        actuator = servo(spec, target)
        actuator.name = actuator.name or f"{target}_servo"
        sensor = spec.sensor(target + MEASURED_SUFFIX)
        sensor.type, sensor.objtype = mujoco.mjtSensor.mjSENS_ACTUATORPOS, mujoco.mjtObj.mjOBJ_ACTUATOR
        sensor.objname = actuator.name

    def write(self, fields: Fields, target: str, values: Values) -> None:
        actuator = joint_index(fields.model, target)["actuator"]
        if is_pid(fields.model, actuator):
            raise EdreamError(f"Servo of joint {target!r} is a PID, whose command MuJoCo cannot scale; drop gear_ratio there.")
        law, scale = fields["actuator_biasprm"], values["encoder"]
        fields["actuator_gainprm"][:, actuator, 0] = -law[:, actuator, 1] * values["ratio"] / scale
        law[:, actuator, 1] /= scale
        law[:, actuator, 2] /= np.square(scale)
        fields["actuator_gear"][:, actuator, 0] = scale


ENTRY = GearRatio()
