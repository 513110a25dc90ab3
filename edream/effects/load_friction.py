"""Friction that grows with the load on the gear."""

from collections.abc import Sequence
from typing import Any

import mujoco

from edream.core.effect import Effect, State
from edream.core.parameters import Parameter
from edream.sim.friction import hold_still
from edream.sim.rotor import drive_joint


def load_friction(state: State, index: dict[str, int], values: dict[str, Any]) -> None:
    """Dry friction grows with the torque that gravity and motion put on the joint."""
    load = abs(state.qfrc_bias[:, index["dof"]])
    state.friction[:, index["drive"]] += values["slope"] * load


class LoadFriction(Effect):
    """Dry friction proportional to the load that the gear carries.

        F = F0 + k |load|

    The loop between measured and commanded position is wide where gravity pulls and narrow where it does not. MJCF has no such
    term: a hook sets `dof_frictionloss` before each step. Parameter: slope k [1].
    Source: Bittencourt, Gunnarsson, IEEE/ASME Transactions on Mechatronics 17(4), 2012; Duclusaud et al. (BAM), 2024.
    """

    name = "load_friction"
    summary = "load-dependent friction"
    place = "joint"
    confusable = ("coulomb", "directional_efficiency")
    hook = staticmethod(load_friction)

    def parameters(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[Parameter, ...]:
        return (Parameter("slope", "1", 0.0, 2.0, 0.0, absent=0.0),)

    def edit(self, spec: mujoco.MjSpec, target: str) -> None:
        hold_still(spec, drive_joint(spec, target))


ENTRY = LoadFriction()
