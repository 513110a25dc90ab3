"""Dry friction that differs between the two directions."""

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from edream.core.effect import Effect, State
from edream.core.parameters import Parameter
from edream.sim.friction import hold_still
from edream.sim.rotor import drive_joint
from edream.sim.scales import largest


def asymmetric_coulomb(state: State, index: dict[str, int], values: dict[str, Any]) -> None:
    """Dry friction is larger in one direction of motion than in the other."""
    dof = index["drive"]
    side = np.tanh(state.qvel[:, dof] / 0.02)
    state.friction[:, dof] = np.maximum(state.friction[:, dof] + values["difference"] * side, 0.0)


class AsymmetricCoulomb(Effect):
    """A gear that runs harder one way than the other.

        F = F0 + d for qd > 0,  F0 - d for qd < 0,  F >= 0

    Shifts the loop between measured and commanded position, but only while the joint moves: `constant_torque` shifts it at rest,
    too. The turn between the directions is smooth over 0.02 rad/s. A hook sets `dof_frictionloss` before each step. Parameter:
    difference d, half of that between the directions [N m]. Source: Armstrong-Helouvry, Dupont, Canudas de Wit, 1994.
    """

    name = "asymmetric_coulomb"
    summary = "dry friction that differs between the directions"
    place = "joint"
    confusable = ("constant_torque", "directional_efficiency", "gravity_tilt")
    hook = staticmethod(asymmetric_coulomb)

    def parameters(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[Parameter, ...]:
        high = 0.5 * largest(model, targets)
        return (Parameter("difference", "N m", -high, high, 0.0, absent=0.0),)

    def edit(self, spec: mujoco.MjSpec, target: str) -> None:
        hold_still(spec, drive_joint(spec, target))


ENTRY = AsymmetricCoulomb()
