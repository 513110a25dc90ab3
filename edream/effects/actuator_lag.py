"""A servo that follows its command with a lag."""

from collections.abc import Sequence

import mujoco

from edream.core.effect import Effect, Fields, Values, joint_index
from edream.core.errors import EdreamError
from edream.core.parameters import Parameter
from edream.sim.servo import servo


class ActuatorLag(Effect):
    """First-order filter between command and servo.

        T ud = command - u,  tau = kp (u - q) - kv qd

    Phase lag that saturates at 90 degrees while the amplitude drops; `actuator_delay` keeps the amplitude. Writes the time
    constant of `dyntype="filterexact"`, one activation. Parameter: time T [s]. Source: MuJoCo XML reference,
    actuator/general/dyntype.
    """

    name = "actuator_lag"
    summary = "a lag of the servo"
    place = "joint"
    confusable = ("actuator_delay", "viscous", "slew_limit")

    def parameters(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[Parameter, ...]:
        return (Parameter("time", "s", 0.0, 0.3, 0.0, absent=0.0),)

    def probes(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[dict[str, float], ...]:
        return ({"time": 0.01},)

    def edit(self, spec: mujoco.MjSpec, target: str) -> None:
        actuator = servo(spec, target)
        if actuator.dyntype not in (mujoco.mjtDyn.mjDYN_NONE, mujoco.mjtDyn.mjDYN_FILTEREXACT):
            raise EdreamError(f"Servo of joint {target!r} already has dynamics of its own; MuJoCo cannot give it a filter as well.")
        actuator.dyntype = mujoco.mjtDyn.mjDYN_FILTEREXACT
        actuator.actearly = True

    def write(self, fields: Fields, target: str, values: Values) -> None:
        fields["actuator_dynprm"][:, joint_index(fields.model, target)["actuator"], 0] = values["time"]


ENTRY = ActuatorLag()
