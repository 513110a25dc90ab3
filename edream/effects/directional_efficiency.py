"""A gear that loses more when it lifts than when it is driven back."""

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from edream.core.effect import Effect, State
from edream.core.parameters import Parameter
from edream.sim.friction import hold_still
from edream.sim.rotor import drive_joint


def directional_efficiency(state: State, index: dict[str, int], values: dict[str, Any]) -> None:
    """Dry friction grows with the load, by another factor when the joint lifts than when it lowers."""
    dof, load = index["drive"], state.gear_torque[:, index["dof"]]
    state.friction[:, dof] += values["slope"] * np.abs(load)
    state.torque[:, dof] -= values["slope"] * values["asymmetry"] * load


def directional_efficiency_by_way(state: State, index: dict[str, int], values: dict[str, Any]) -> None:
    """Dry friction grows with the load, by another factor when the joint lifts; at rest it is the way that it is held from."""
    dof, load = index["drive"], state.gear_torque[:, index["dof"]]
    share = np.maximum(1.0 + values["asymmetry"] * state.way(dof) * np.sign(load), 0.0)
    state.friction[:, dof] += values["slope"] * share * abs(load)


class CreepingDirectionalEfficiency(Effect):
    """The same beside dry friction that lets stuck joints creep: its bound depends on the way that the joint goes, or is held from.

        F = F0 + k |load| max(1 + a s, 0)

    Such a joint creeps to where nothing pulls at it, and a torque pulls also at rest. Parameters: those of `DirectionalEfficiency`.
    """

    name = "directional_efficiency"
    summary = "a gear efficiency that differs between lifting and lowering"
    place = "joint"
    confusable = ("load_friction", "asymmetric_coulomb", "coulomb")
    special = ("load_friction", "asymmetry", 0.0)
    hook = staticmethod(directional_efficiency_by_way)

    def parameters(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[Parameter, ...]:
        return (
            Parameter("slope", "1", 0.0, 2.0, 0.0, absent=0.0),
            Parameter("asymmetry", "1", -1.2, 1.2, 0.6),
        )

    def probes(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[dict[str, float], ...]:
        return ({"slope": 0.1, "asymmetry": 0.8}, {"slope": 0.1, "asymmetry": -0.8})

    def edit(self, spec: mujoco.MjSpec, target: str) -> None:
        hold_still(spec, drive_joint(spec, target))


class DirectionalEfficiency(CreepingDirectionalEfficiency):
    """Friction proportional to the load, with another factor for lifting than for lowering.

        F = F0 + k |load| (1 + a s),  s = 1 while the joint moves against its load, -1 while the load drives it

    With a = 0 this is `load_friction`; a > 0 is a gear whose driving loses more than its being driven back. Friction between two
    unequal bounds is friction between their mean and a torque -k a load, in motion and at rest; a hook sets both before each step.
    Parameters: slope k [1], asymmetry a [1]. Source: Wang, Kim, IJRR 2015 (directional gear efficiency); Duclusaud et al. (BAM),
    2024.
    """

    hook = staticmethod(directional_efficiency)
    creeping = CreepingDirectionalEfficiency()


ENTRY = DirectionalEfficiency()
