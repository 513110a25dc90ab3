"""A servo that weakens, or stiffens, with time."""

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from edream.core.effect import Effect, State
from edream.core.parameters import Parameter


def gain_fade(state: State, index: dict[str, int], values: dict[str, Any]) -> None:
    """The servo's position gain changes with the time since the recording began."""
    error = state.ctrl[:, index["ctrl"]] - state.qpos[:, index["drive_qpos"]]
    lost = np.clip(values["rate"] * state.time, -0.95, 0.95)
    state.torque[:, index["drive"]] -= lost * state.gain[:, index["actuator"]] * error


class GainFade(Effect):
    """Position gain that falls with the time since the recording began: a motor that heats up or a supply that sags.

        tau = kp (1 - r t) (u - q),  r t <= 0.95

    Sag under gravity grows during a recording. A hook adds the torque that is missing. Parameter: rate r [1/s].
    Source: MuJoCo technical note on DC motors, thermal model; Bittencourt, Gunnarsson, 2012.
    """

    name = "gain_fade"
    summary = "a servo gain that drifts with time"
    place = "joint"
    confusable = ("friction_fade", "servo_gain")
    of_position_servo = True
    hook = staticmethod(gain_fade)

    def parameters(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[Parameter, ...]:
        return (Parameter("rate", "1/s", -0.2, 0.2, 0.0, absent=0.0),)

    def probes(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[dict[str, float], ...]:
        return ({"rate": 0.003}, {"rate": -0.003})


ENTRY = GainFade()
