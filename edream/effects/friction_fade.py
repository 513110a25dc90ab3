"""Dry friction that changes as the joint warms up."""

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from edream.core.effect import Effect, State
from edream.core.parameters import Parameter
from edream.sim.friction import hold_still
from edream.sim.rotor import drive_joint


def friction_fade(state: State, index: dict[str, int], values: dict[str, Any]) -> None:
    """Dry friction changes with the time since the recording began."""
    state.friction[:, index["drive"]] *= np.maximum(1.0 - values["rate"] * state.time, 0.0)


class FrictionFade(Effect):
    """Dry friction that falls, or grows, in proportion to the time since the recording began.

        F(t) = F0 max(1 - r t, 0)

    The same motion lags less at the end of a recording than at its start. A hook scales `dof_frictionloss` before each step, after
    every other friction was added. Parameter: rate r [1/s]. Source: Bittencourt, Gunnarsson, IEEE/ASME T. Mechatronics 17(4), 2012.
    """

    name = "friction_fade"
    summary = "dry friction that drifts with time"
    place = "joint"
    confusable = ("gain_fade",)
    hook = staticmethod(friction_fade)
    late = 1

    def parameters(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[Parameter, ...]:
        return (Parameter("rate", "1/s", -1.0, 1.0, 0.0, absent=0.0),)

    def probes(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[dict[str, float], ...]:
        return ({"rate": 0.005}, {"rate": -0.05})

    def edit(self, spec: mujoco.MjSpec, target: str) -> None:
        hold_still(spec, drive_joint(spec, target))


ENTRY = FrictionFade()
