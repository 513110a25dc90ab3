"""Measurements that come late."""

from collections.abc import Sequence

import mujoco
import numpy as np

from edream.core.effect import MEASURED_SUFFIX, Effect, Fields, Values
from edream.core.parameters import Parameter
from edream.sim.servo import read_by_sensors

LONGEST = 0.12


class SensorDelay(Effect):
    """Time between a position and the moment it is stamped.

        q_measured(t) = q(t - T)

    Shifts every signal of one sensor alike, also where torque is off; in free motion only the sum with `actuator_delay` shows.
    Adds a `jointpos` sensor `<joint>_measured` on every driven joint and writes its `delay`. Parameter: time T [s].
    Source: MuJoCo computation chapter, Delays.
    """

    name = "sensor_delay"
    summary = "a delay of the measurements"
    place = "joint"
    confusable = ("actuator_delay", "actuator_lag", "viscous")
    reads_past = True

    def parameters(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[Parameter, ...]:
        return (Parameter("time", "s", 0.0, LONGEST - 2 * float(model.opt.timestep), 0.0, absent=0.0),)

    def probes(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[dict[str, float], ...]:
        return ({"time": 0.01},)

    def edit(self, spec: mujoco.MjSpec, target: str) -> None:
        read_by_sensors(spec)
        sensor = spec.sensor(target + MEASURED_SUFFIX)
        sensor.nsample = int(np.ceil(LONGEST / spec.option.timestep)) + 1
        sensor.interp = 1
        sensor.delay = float(spec.option.timestep)

    def write(self, fields: Fields, target: str, values: Values) -> None:
        fields["sensor_delay"][:, fields.model.sensor(target + MEASURED_SUFFIX).id] = values["time"]


ENTRY = SensorDelay()
