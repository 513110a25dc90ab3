"""A servo that ignores small errors."""

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from edream.core.effect import Effect, State
from edream.core.parameters import Parameter


def dead_zone(state: State, index: dict[str, int], values: dict[str, Any]) -> None:
    """The servo gives no torque while its error is inside a band."""
    error = state.ctrl[:, index["ctrl"]] - state.qpos[:, index["drive_qpos"]]
    inside = np.clip(error, -values["width"], values["width"])
    state.torque[:, index["drive"]] += state.let_through(index, -state.gain[:, index["actuator"]] * inside)


class DeadZone(Effect):
    """A servo whose motor gets no current for position errors below a threshold.

        tau = kp sign(e) max(|e| - w, 0),  e = u - q

    The joint rests anywhere within the band, also without load. A hook takes back what the servo gives inside the band, at the same
    state as the servo's own law and within its limit. Parameter: width w, half of the band [rad]. Source: Olsson et al., European
    J. of Control 4(3), 1998.
    """

    name = "dead_zone"
    summary = "a dead zone of the servo"
    place = "joint"
    confusable = ("coulomb", "backlash")
    of_position_servo = True
    hook = staticmethod(dead_zone)

    def parameters(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[Parameter, ...]:
        return (Parameter("width", "rad", 0.0, 0.15, 0.0, absent=0.0),)

    def probes(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[dict[str, float], ...]:
        return ({"width": 0.005},)


ENTRY = DeadZone()
