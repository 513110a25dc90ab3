"""Dry friction that differs along the joint's travel."""

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from edream.core.effect import Effect, State
from edream.core.parameters import Parameter
from edream.sim.friction import hold_still
from edream.sim.rotor import drive_joint
from edream.sim.scales import largest


def position_friction(state: State, index: dict[str, int], values: dict[str, Any]) -> None:
    """Dry friction differs along the joint's travel, one wave a turn."""
    dof, angle = index["drive"], state.qpos[:, index["qpos"]]
    wave = values["cosine"] * np.cos(angle) + values["sine"] * np.sin(angle)
    state.friction[:, dof] = np.maximum(state.friction[:, dof] + wave, 0.0)


class PositionFriction(Effect):
    """A bent shaft, a worn stretch or a tight seal: the joint runs harder in some places than in others.

        F = max(F0 + a cos(q) + b sin(q), 0)

    One full wave over a turn; over an arm joint's range that is a slope (b) and a bulge (a). The loop between measured and
    commanded position is wide in some places and narrow in others, whatever gravity does. A hook sets `dof_frictionloss` before
    each step. Parameters: cosine a, sine b [N m]. Source: Tuttle, MIT PhD thesis, 1992.
    """

    name = "position_friction"
    summary = "dry friction that differs along the joint's travel"
    place = "joint"
    confusable = ("load_friction", "cogging")
    hook = staticmethod(position_friction)

    def parameters(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[Parameter, ...]:
        high = 0.5 * largest(model, targets)
        return (
            Parameter("cosine", "N m", -high, high, 0.0, absent=0.0),
            Parameter("sine", "N m", -high, high, 0.0, absent=0.0),
        )

    def probes(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[dict[str, float], ...]:
        torque = 0.04 * largest(model, targets)
        return tuple({"cosine": a * torque, "sine": b * torque} for a, b in ((1.0, 0.0), (0.0, 1.0), (0.0, -1.0)))

    def edit(self, spec: mujoco.MjSpec, target: str) -> None:
        hold_still(spec, drive_joint(spec, target))


ENTRY = PositionFriction()
