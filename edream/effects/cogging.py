"""Torque that repeats with the angle."""

from collections.abc import Sequence

import mujoco
import numpy as np

from edream.core.effect import Effect, Fields, Values
from edream.core.parameters import Parameter
from edream.sim.scales import largest, most_torque, travel
from edream.sim.servo import NO_INPUT, device, passive_device

PERIODS = (6.0, 7.0, 8.0, 10.0, 12.0, 14.0, 16.0, 20.0, 24.0, 28.0, 32.0, 40.0, 48.0, 64.0)  # a turn of the joint


class Cogging(Effect):
    """Torque ripple of the motor's magnets or the gear's teeth.

        tau = A sin(N q + phi)

    A narrow line in the spectrum over angle, at the same wavelength for every speed. Native: a `dcmotor` without input.
    Parameters: amplitude A [N m], periods N a turn of the joint [1], phase phi [rad]. Source: MuJoCo XML reference,
    actuator/dcmotor/cogging.
    """

    name = "cogging"
    summary = "a torque ripple that repeats with the angle (cogging)"
    place = "joint"
    confusable = ("position_friction", "spring")
    of_type = False
    phase = "phase"

    def parameters(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[Parameter, ...]:
        return (
            Parameter("amplitude", "N m", 0.0, most_torque(model, targets), 0.0, absent=0.0),
            Parameter("periods", "1", 6.0, 120.0, 12.0, scale="log"),
            Parameter("phase", "1", -2.0 * np.pi, 2.0 * np.pi, 0.0),
        )

    def probes(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[dict[str, float], ...]:
        amplitude = 0.03 * largest(model, targets)
        waves = [(periods, phase) for periods in PERIODS for phase in (0.0, np.pi / 2.0)]
        return tuple({"amplitude": amplitude, "periods": periods, "phase": phase} for periods, phase in waves)

    def scan(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[dict[str, float], ...]:
        low, high = travel(model, targets[0])
        step = max(0.5, np.pi / max(high - low, 0.1))  # a quarter of a period from end to end of the travel, to either side
        amplitude = 0.03 * largest(model, targets)
        waves = [(periods, phase) for periods in np.arange(PERIODS[0], PERIODS[-1], step) for phase in (0.0, np.pi / 2.0)]
        return tuple({"amplitude": amplitude, "periods": float(periods), "phase": phase} for periods, phase in waves)

    def edit(self, spec: mujoco.MjSpec, target: str) -> None:
        device_ = passive_device(spec, target, "cogging")
        device_.set_to_dcmotor(motorconst=[0.0, 0.0], resistance=1.0, cogging=[1e-9, 12.0, 0.0], ctrlspec=NO_INPUT)

    def write(self, fields: Fields, target: str, values: Values) -> None:
        law = fields["actuator_biasprm"][:, device(fields.model, target, "cogging")]
        law[:, 0], law[:, 1], law[:, 2] = values["amplitude"], values["periods"], values["phase"]


ENTRY = Cogging()
