"""A servo that follows its command no faster than so."""

from collections.abc import Sequence

import mujoco
import numpy as np

from edream.core.effect import Effect, Fields, Values, joint_index
from edream.core.parameters import Parameter
from edream.sim.servo import as_pid

NONE = 1000.0  # rad/s: faster than any command


class SlewLimit(Effect):
    """Speed limit of the setpoint inside the servo.

        |d setpoint / dt| <= s,  tau = kp (setpoint - q) - kv qd

    Steps become ramps of one slope; slow motions are untouched. Writes `slewmax` of MuJoCo's `pid` actuator, one activation.
    Parameter: speed s [rad/s]. Source: MuJoCo XML reference, actuator/pid/slewmax.
    """

    name = "slew_limit"
    summary = "a speed limit of the setpoint"
    place = "joint"
    confusable = ("torque_speed_limit", "torque_limit", "actuator_lag", "viscous")
    of_position_servo = True

    def parameters(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[Parameter, ...]:
        return (Parameter("speed", "rad/s", 0.05, NONE, NONE, absent=NONE, scale="log"),)

    def probes(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[dict[str, float], ...]:
        # close to each other: a limit does nothing above the speeds of a command
        return tuple({"speed": float(speed)} for speed in np.geomspace(0.2, 6.4, 12))

    def edit(self, spec: mujoco.MjSpec, target: str) -> None:
        actuator = as_pid(spec, target)
        law = np.array(actuator.dynprm)
        law[1] = NONE
        actuator.dynprm = law

    def write(self, fields: Fields, target: str, values: Values) -> None:
        fields["actuator_dynprm"][:, joint_index(fields.model, target)["actuator"], 1] = values["speed"]


ENTRY = SlewLimit()
