"""A servo that weakens, or stiffens, with time."""

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from edream.core.effect import Effect, Fields, State, Values
from edream.core.parameters import Parameter
from edream.sim.servo import damping_inside, share_damping


def gain_fade(state: State, index: dict[str, int], values: dict[str, Any]) -> None:
    """The servo's torque changes with the time since the recording began."""
    lost = np.clip(values["rate"] * state.time, -0.95, 0.95)
    state.torque[:, index["drive"]] -= lost * state.actuator_force[:, index["force"]]


class GainFade(Effect):
    """A servo's torque that falls with the time since the recording began: a motor that heats up or a supply that sags.

        tau = (1 - r t) (kp (u - q) - kv qd),  r t <= 0.95

    Sag under gravity grows during a recording. A hook takes away what is missing of the servo's torque, its share of the damping
    included. Parameters: rate r [1/s]; inside: that share [1], about as published.
    Source: MuJoCo technical note on DC motors, thermal model; Bittencourt, Gunnarsson, 2012.
    """

    name = "gain_fade"
    summary = "a servo gain that drifts with time"
    place = "joint"
    confusable = ("friction_fade", "servo_gain")
    hook = staticmethod(gain_fade)
    late = 2

    def parameters(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[Parameter, ...]:
        return (Parameter("rate", "1/s", -0.2, 0.2, 0.0, absent=0.0), damping_inside(model, targets))

    def probes(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[dict[str, float], ...]:
        inside = self.parameters(model, targets)[1].start
        return ({"rate": 0.003, "inside": inside}, {"rate": -0.003, "inside": inside})

    def write(self, fields: Fields, target: str, values: Values) -> None:
        share_damping(fields, target, values["inside"])


ENTRY = GainFade()
