"""Time between a command and its torque."""

from collections.abc import Sequence

import mujoco
import numpy as np

from edream.core.effect import Effect, Fields, Values, joint_index
from edream.core.parameters import Parameter
from edream.sim.servo import servo

LONGEST = 0.12


class ActuatorDelay(Effect):
    """Commands arrive late by a constant time.

        tau(t) = servo(u(t - T))

    Phase falls linearly with frequency, whatever the amplitude. Writes the actuator's `delay` over a history buffer with
    linear interpolation, which is at least one step. Parameter: time T [s]. Source: MuJoCo computation chapter, Delays.
    """

    name = "actuator_delay"
    summary = "a delay of the commands"
    place = "joint"
    confusable = ("sensor_delay", "actuator_lag")

    def parameters(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[Parameter, ...]:
        return (Parameter("time", "s", 0.0, LONGEST - 2 * float(model.opt.timestep), 0.0, absent=0.0),)

    def probes(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[dict[str, float], ...]:
        return ({"time": 0.01},)

    def edit(self, spec: mujoco.MjSpec, target: str) -> None:
        actuator = servo(spec, target)
        actuator.nsample = int(np.ceil(LONGEST / spec.option.timestep)) + 1
        actuator.interp = 1
        actuator.delay = float(spec.option.timestep)

    def write(self, fields: Fields, target: str, values: Values) -> None:
        fields["actuator_delay"][:, joint_index(fields.model, target)["actuator"]] = values["time"]


ENTRY = ActuatorDelay()
