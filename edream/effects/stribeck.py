"""Extra friction near standstill that fades with speed."""

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from edream.core.effect import Effect, State
from edream.core.parameters import Parameter
from edream.sim.friction import hold_still
from edream.sim.rotor import drive_joint
from edream.sim.scales import largest, most_torque


def stribeck(state: State, index: dict[str, int], values: dict[str, Any]) -> None:
    """Dry friction is larger near standstill and fades with the square of speed."""
    dof = index["drive"]
    state.friction[:, dof] += values["torque"] * np.exp(-((state.qvel[:, dof] / values["speed"]) ** 2))


class Stribeck(Effect):
    """Stiction: dry friction is larger near standstill than on the move.

        F = F0 + k exp(-(qd / vs)^2)

    Stick-slip on slow moves and nothing on fast ones. A hook sets `dof_frictionloss` before each step, so the joint truly sticks.
    Parameters: torque k [N m], speed vs [rad/s]. Source: Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 30(7), 1994.
    """

    name = "stribeck"
    summary = "friction that falls with speed (Stribeck)"
    place = "joint"
    confusable = ("coulomb", "viscous", "presliding")
    hook = staticmethod(stribeck)

    def parameters(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[Parameter, ...]:
        high = 2.0 * most_torque(model, targets)
        return (
            Parameter("torque", "N m", 0.0, high, 0.0, absent=0.0),
            Parameter("speed", "rad/s", 0.005, 3.0, 0.1, scale="log"),
        )

    def probes(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[dict[str, float], ...]:
        torque = 0.05 * largest(model, targets)
        return tuple({"torque": torque, "speed": speed} for speed in (0.05, 0.2, 0.8))

    def edit(self, spec: mujoco.MjSpec, target: str) -> None:
        hold_still(spec, drive_joint(spec, target))


ENTRY = Stribeck()
