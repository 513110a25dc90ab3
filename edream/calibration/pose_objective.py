"""The paper's loss: end-effector translation [m] plus rotation [rad], in a form that least squares can minimise."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from edream.calibration.pose import Chain
from edream.sim.objective import STEP
from edream.sim.rollout import rollout
from edream.sim.simulation import SimulatedRobot
from edream.sim.window import Window

UNSTABLE = 3.0
SOFT = 1e-3  # m or rad: below it an error counts by its square, so that the loss has a derivative at 0


@dataclass(eq=False)
class PoseObjective:
    """Open-loop end-effector residuals over fixed windows; stands where an `Objective` stands.

        loss = mean_t |x_sim - x_meas| + mean_t angle(R_sim R_meas')

    Each error vector e becomes e / sqrt(|e| + soft), whose square is |e|: the sum of squares is the paper's sum of norms.
    """

    simulated: SimulatedRobot
    windows: Sequence[Window]
    joints: Bool[np.ndarray, "J"] | None = None
    stride: int = 1
    threads: int = 0
    rotation: Literal["geodesic", "arcsin"] = "geodesic"
    simulations: int = field(default=0)
    step: float = STEP

    @cached_property
    def chain(self) -> Chain:
        return Chain(self.simulated.robot)

    @cached_property
    def poses(self) -> list[tuple[np.ndarray, Rotation]]:
        return [self.chain.poses(window.measured[1 :: self.stride]) for window in self.windows]

    @cached_property
    def measured(self) -> list[Float[np.ndarray, "T 6"]]:
        return [np.concatenate([where, turn.as_rotvec()], axis=1) for where, turn in self.poses]

    @cached_property
    def acts_on(self) -> Bool[np.ndarray, "P 6"]:
        """Every joint moves the whole pose."""
        return np.ones((len(self.simulated.space), 6), bool)

    def residuals(self, values: Float[np.ndarray, "N P"]) -> Float[np.ndarray, "N R"]:
        """Softened translation and rotation errors, six a row, windows one after the other."""
        values = np.atleast_2d(values)
        self.simulations += len(values) * len(self.windows)
        simulated = rollout(self.simulated.swift, values, self.windows, self.threads)
        return np.stack(
            [
                np.concatenate([self._error(s[n], *p) for s, p in zip(simulated, self.poses, strict=True)])
                for n in range(len(values))
            ]
        )

    def _error(self, positions: np.ndarray, where: np.ndarray, turn: Rotation) -> np.ndarray:
        rows = positions[1 :: self.stride]
        good = np.asarray(np.isfinite(rows).all(axis=1))
        x, r = self.chain.poses(np.where(good[:, None], rows, 0.0))
        angle = (r * turn.inv()).as_rotvec() * (1.0 if self.rotation == "geodesic" else 0.5)
        out = np.concatenate([_soften(x - where), _soften(angle)], axis=1)
        out[~good] = UNSTABLE
        return out.ravel()

    def per_window(self, residual: Float[np.ndarray, "R"]) -> list[Float[np.ndarray, "T 6"]]:
        """One residual vector as (time, six) arrays, one a window."""
        ends = np.cumsum([m.size for m in self.measured])[:-1]
        return [part.reshape(m.shape) for part, m in zip(np.split(residual, ends), self.measured, strict=True)]


def _soften(error: np.ndarray) -> np.ndarray:
    return error / np.sqrt(np.linalg.norm(error, axis=1, keepdims=True) + SOFT)
