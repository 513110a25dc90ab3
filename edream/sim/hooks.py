"""Hooks: what MJCF cannot say, applied before each step to one `MjData` or to a whole batch."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from jaxtyping import Float
from mujoco import batch

from edream.sim.simulation import SimulatedRobot, hook_index


class BatchState:
    """What hooks see of a batch: `edream.core.effect.State` for N simulations."""

    def __init__(self, simulations: batch.Batch, simulated: SimulatedRobot) -> None:
        bind = simulations.bind
        self.clock = bind("time")
        self.qpos, self.qvel, self.ctrl = bind("qpos"), bind("qvel"), bind("ctrl")
        self.qfrc_bias, self.actuator_force = bind("qfrc_bias"), bind("actuator_force")
        self.gain = simulations.expand("actuator_gainprm")[:, :, 0]
        self.friction = simulations.expand("dof_frictionloss")
        self.torque = bind("qfrc_applied")
        self.base_friction = self.friction.copy()

    @property
    def time(self) -> Float[np.ndarray, "N"]:
        return self.clock.reshape(len(self.clock))


def batch_hooks(
    simulated: SimulatedRobot, simulations: batch.Batch, numbers: Sequence[Mapping[str, Float[np.ndarray, "N"]]]
) -> Callable[[], None] | None:
    """One function that applies every hook to a batch, or None where no effect has one.

    Call it after the fields are written: the friction that they hold is what hooks add to.
    """
    if not simulated.has_hooks:
        return None
    state = BatchState(simulations, simulated)
    calls = [
        (placement.effect.hook, hook_index(simulated.model, placement.effect, target), values)
        for placement, values in zip(simulated.placements, numbers, strict=True)
        if placement.effect.hook is not None
        for target in placement.targets or ("",)
    ]

    def apply() -> None:
        state.friction[:] = state.base_friction
        state.torque[:] = 0.0
        for hook, index, values in calls:
            hook(state, index, values)

    return apply
