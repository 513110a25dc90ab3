"""How far a simulated robot is from its recordings, as residuals that a fit can use."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float

from edream.sim.rollout import rollout
from edream.sim.simulation import SimulatedRobot
from edream.sim.window import Window

STEP = 2e-3  # of the unit box: large enough to cross the kinks of dry friction, small enough to be a derivative
UNSTABLE_RESIDUAL = 10.0  # rad; what a row counts once its simulation has blown up


@dataclass(eq=False)
class Objective:
    """Open-loop residuals of joint positions over fixed windows.

    Attributes:
        simulated: the robot and the effects whose parameters are searched.
        windows: stretches that are replayed.
        joints: which joints count, (J,), or None for all.
        stride: every how many measurements one counts.
        threads: simulation threads, 0 for all.
        simulations: windows simulated so far, over all calls.
        step: of differences, in the unit box.
        offset: what is added to every residual [rad], such as what shorter steps would make of it, (R,); None for nothing.
    """

    simulated: SimulatedRobot
    windows: Sequence[Window]
    joints: Bool[np.ndarray, "J"] | None = None
    stride: int = 1
    threads: int = 0
    simulations: int = field(default=0)
    step: float = STEP
    offset: Float[np.ndarray, "R"] | None = None

    @cached_property
    def measured(self) -> list[Float[np.ndarray, "T J"]]:
        return [self._chosen(window.measured) for window in self.windows]

    @cached_property
    def owner(self) -> np.ndarray:
        """Number of the window that each residual belongs to, (R,)."""
        return np.concatenate([np.full(m.size, i) for i, m in enumerate(self.measured)])

    @cached_property
    def acts_on(self) -> Bool[np.ndarray, "P C"]:
        """Which columns of (time, joint) rows each parameter moves first: the joints it acts on, or all where that is not known."""
        names = np.array(self.simulated.robot.joints)
        names = names if self.joints is None else names[self.joints]
        rows = []
        for placement in self.simulated.placements:
            direct = np.isin(names, placement.targets) if placement.effect.place == "joint" else np.zeros(len(names), bool)
            rows += [direct if direct.any() else ~direct] * len(placement.parameters(self.simulated.robot.model))
        return np.array(rows, bool).reshape(-1, len(names))

    def _chosen(self, positions: np.ndarray) -> np.ndarray:
        rows = positions[..., 1 :: self.stride, :]
        return rows if self.joints is None else rows[..., self.joints]

    def residuals(self, values: Float[np.ndarray, "N P"]) -> Float[np.ndarray, "N R"]:
        """Simulated minus measured positions [rad], windows one after the other, each (time, joint) row by row."""
        values = np.atleast_2d(values)
        self.simulations += len(values) * len(self.windows)
        simulated = rollout(self.simulated.swift, values, self.windows, self.threads)
        parts = [(self._chosen(s) - m).reshape(len(values), -1) for s, m in zip(simulated, self.measured, strict=True)]
        residuals = np.nan_to_num(np.concatenate(parts, axis=1), nan=UNSTABLE_RESIDUAL)
        return residuals if self.offset is None else residuals + self.offset

    def per_window(self, residual: Float[np.ndarray, "R"]) -> list[Float[np.ndarray, "T J"]]:
        """One residual vector as (time, joint) arrays, one a window."""
        ends = np.cumsum([m.size for m in self.measured])[:-1]
        return [part.reshape(m.shape) for part, m in zip(np.split(residual, ends), self.measured, strict=True)]


def rms(residual: np.ndarray) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(residual))))
