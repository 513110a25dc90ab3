"""Hooks: what MJCF cannot say, applied before each step to one `MjData` or to a whole batch."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from mujoco import batch

from edream.sim.friction import way
from edream.sim.limits import let_through, limits_of
from edream.sim.memory import at_rest, recent
from edream.sim.simulation import SimulatedRobot, hook_index, late_last


class BatchState:
    """What hooks see of a batch: `edream.core.effect.State` for N simulations."""

    recent, let_through, way = recent, let_through, way

    def __init__(
        self, simulations: batch.Batch, start: Float[np.ndarray, "N"] | float = 0.0, past: Callable[[int, float], Any] | None = None
    ) -> None:
        bind = simulations.bind
        self.clock = bind("time")
        self.qpos, self.qvel, self.ctrl = bind("qpos"), bind("qvel"), bind("ctrl")
        self.qfrc_bias, self.actuator_force = bind("qfrc_bias"), bind("actuator_force")
        self._smooth, self.constraint, self._qacc = bind("qfrc_smooth"), bind("qfrc_constraint"), bind("qacc")
        self._armature = simulations.expand("dof_armature")
        self._bias = simulations.expand("actuator_biasprm")
        self.friction = simulations.expand("dof_frictionloss")
        self.torque = bind("qfrc_applied")
        self.base_friction = self.friction.copy()
        self.start = start
        model = simulations.get_model(0)
        self.limits = limits_of(model, simulations.expand("actuator_forcerange"))
        self.step, self.memory = float(model.opt.timestep), dict[Any, Any]()
        self.past = past or at_rest

    @property
    def time(self) -> Float[np.ndarray, "N"]:
        return self.clock.reshape(len(self.clock)) + self.start

    @property
    def gear_torque(self) -> Float[np.ndarray, "N nv"]:
        return self._smooth + self.qfrc_bias + self.constraint - self._armature * self._qacc

    @property
    def gain(self) -> Float[np.ndarray, "N actuators"]:
        """Position gains in force: the bias term holds them for position and PID servos alike."""
        return -self._bias[:, :, 1]

    @property
    def speed_gain(self) -> Float[np.ndarray, "N actuators"]:
        return -self._bias[:, :, 2]


def batch_hooks(
    simulated: SimulatedRobot,
    simulations: batch.Batch,
    numbers: Sequence[Mapping[str, Float[np.ndarray, "N"]]],
    start: Float[np.ndarray, "N"] | float = 0.0,
    past: Callable[[int, float], Any] | None = None,
) -> Callable[[], None] | None:
    """One function that applies every hook to a batch, or None where no effect has one.

    Call it after the fields are written: the friction that they hold is what hooks add to.

    Args:
        start: time of each simulation's first step since its recording began [s].
        past: what `recent` begins with, (N,) for a dof and seconds; None for rest.
    """
    if not simulated.has_hooks:
        return None
    state = BatchState(simulations, start, past)
    calls = [
        (placement.effect.hook, hook_index(simulated.model, placement.effect, target), values)
        for placement, values in late_last(zip(simulated.placements, numbers, strict=True))
        if placement.effect.hook is not None
        for target in placement.targets or ("",)
    ]

    def apply() -> None:
        state.friction[:] = state.base_friction
        state.torque[:] = 0.0
        for hook, index, values in calls:
            hook(state, index, values)

    return apply
