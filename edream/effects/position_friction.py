"""Dry friction that differs along the joint's travel."""

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from edream.core.effect import Effect, State
from edream.core.parameters import Parameter
from edream.sim.friction import hold_still
from edream.sim.rotor import drive_joint
from edream.sim.scales import largest, most_torque, travel


def position_friction(state: State, index: dict[str, int], values: dict[str, Any]) -> None:
    """Dry friction is larger or smaller around one place of the joint's travel."""
    dof = index["drive"]
    away = np.minimum(np.abs(state.qpos[:, index["qpos"]] - values["centre"]) / values["width"], 1.0)
    more = values["torque"] * 0.5 * (1.0 + np.cos(np.pi * away))
    state.friction[:, dof] = np.maximum(state.friction[:, dof] + more, 0.0)


class PositionFriction(Effect):
    """A bent shaft, a worn stretch or a tight seal: the joint runs harder in some places than in others.

        F = max(F0 + a (1 + cos(pi (q - c) / w)) / 2, 0) for |q - c| < w,  F0 elsewhere

    A narrow w is a tight spot, one as wide as the travel a slope along it. The loop between measured and commanded position is wide
    in some places and narrow in others, whatever gravity does. A hook sets `dof_frictionloss` before each step.
    Parameters: torque a [N m], centre c [rad], half width w [rad]. Source: Tuttle, MIT PhD thesis, 1992.
    """

    name = "position_friction"
    summary = "dry friction that differs along the joint's travel"
    place = "joint"
    confusable = ("load_friction", "cogging")
    of_type = False
    local = True
    hook = staticmethod(position_friction)

    def parameters(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[Parameter, ...]:
        high = 2.0 * most_torque(model, targets)
        low, top = travel(model, targets[0])
        span = top - low
        return (
            Parameter("torque", "N m", -high, high, 0.0, absent=0.0),
            Parameter("centre", "rad", low - 0.2 * span, top + 0.2 * span, 0.5 * (low + top)),
            Parameter("width", "rad", 0.05 * span, 1.5 * span, 0.3 * span, scale="log"),
        )

    def probes(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[dict[str, float], ...]:
        low, top = travel(model, targets[0])
        places = low + (top - low) * np.array([0.1, 0.3, 0.5, 0.7, 0.9])
        shapes = [(0.25, float(place)) for place in places] + [(1.0, low), (1.0, top)]
        torque = 0.04 * largest(model, targets)
        return tuple({"torque": torque, "centre": place, "width": share * (top - low)} for share, place in shapes)

    def edit(self, spec: mujoco.MjSpec, target: str) -> None:
        hold_still(spec, drive_joint(spec, target))


ENTRY = PositionFriction()
