"""Dry friction that differs between the directions."""

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from edream.core.effect import Effect, State
from edream.core.parameters import Parameter
from edream.sim.friction import hold_still
from edream.sim.rotor import drive_joint
from edream.sim.scales import most_torque


def asymmetric_coulomb(state: State, index: dict[str, int], values: dict[str, Any]) -> None:
    """Dry friction is larger one way, and smaller by as much the other way; at rest it is the way that it holds the joint from."""
    dof = index["drive"]
    speed = state.qvel[:, dof]
    more = values["difference"] * np.sign(np.where(abs(speed) > 1e-3, speed, -state.constraint[:, dof]))
    state.friction[:, dof] = np.maximum(state.friction[:, dof] + more, 0.0)


class AsymmetricCoulomb(Effect):
    """A gear that runs harder one way than the other.

        F = max(F0 + d, 0) for qd > 0,  max(F0 - d, 0) for qd < 0

    Where friction holds a stuck joint, two unequal bounds are friction of their mean and a torque of half their difference, in
    motion and at rest: no motion can tell this from `constant_torque` beside another dry friction. But friction only brakes, so
    neither bound falls below zero: a torque larger than the friction beside it is none of friction's. Where a stuck joint creeps it
    creeps to where nothing pulls at it, and no torque does that. A hook sets `dof_frictionloss` before each step by the way that
    the joint goes.
    Parameter: difference d, half of that between the directions [N m]. Source: Armstrong-Helouvry, Dupont, Canudas de Wit, 1994.
    """

    name = "asymmetric_coulomb"
    summary = "dry friction that differs between the directions"
    place = "joint"
    confusable = ("constant_torque", "directional_efficiency", "gravity_tilt")
    hook = staticmethod(asymmetric_coulomb)
    late = 1
    of_type = False
    of_creep = True

    def parameters(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[Parameter, ...]:
        high = 2.0 * most_torque(model, targets)
        return (Parameter("difference", "N m", -high, high, 0.0, absent=0.0),)

    def edit(self, spec: mujoco.MjSpec, target: str) -> None:
        hold_still(spec, drive_joint(spec, target))


ENTRY = AsymmetricCoulomb()
