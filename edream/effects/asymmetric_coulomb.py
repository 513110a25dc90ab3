"""Dry friction that differs between the directions."""

from collections.abc import Sequence
from typing import Any

import mujoco

from edream.core.effect import Effect, State
from edream.core.parameters import Parameter
from edream.sim.friction import hold_still
from edream.sim.rotor import drive_joint


def asymmetric_coulomb(state: State, index: dict[str, int], values: dict[str, Any]) -> None:
    """Dry friction is larger one way, and smaller by as much the other way; at rest it is the way that it holds the joint from."""
    dof = index["drive"]
    state.friction[:, dof] *= 1.0 + values["asymmetry"] * state.way(dof)


class AsymmetricCoulomb(Effect):
    """A gear that runs harder one way than the other.

        F = F0 (1 + a) for qd > 0,  F0 (1 - a) for qd < 0

    F0 is the dry friction that everything else gives, so that neither falls below zero: friction only brakes. Where it holds a
    stuck joint, two unequal bounds are friction of their mean and a torque of half their difference, in motion and at rest: no
    motion can tell this from `constant_torque` beside dry friction, but a torque larger than the friction is none of friction's.
    Where a stuck joint creeps it creeps to where nothing pulls at it, and no torque does that. A hook sets `dof_frictionloss`
    before each step by the way that the joint goes, or is held from going.
    Parameter: asymmetry a, half of the difference between the directions as a share of their mean [1].
    Source: Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 30(7), 1994.
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
        return (Parameter("asymmetry", "1", -1.0, 1.0, 0.0, absent=0.0, attained=True),)

    def edit(self, spec: mujoco.MjSpec, target: str) -> None:
        hold_still(spec, drive_joint(spec, target))


ENTRY = AsymmetricCoulomb()
