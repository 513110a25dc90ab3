"""Inverse kinematics: joint positions that put a hand where it should be."""

import mujoco
import numpy as np
from jaxtyping import Float

from edream.core.bench import Arm
from edream.core.errors import EdreamError

DAMPING = 1e-4
TURN = 0.25  # a radian of the hand's turn counts as so many metres
MOST = 0.2  # largest change of a joint in one iteration [rad]


class Reach:
    """One arm of a robot, by damped least squares. Source: Buss, Introduction to inverse kinematics, 2004."""

    def __init__(self, model: mujoco.MjModel, arm: Arm) -> None:
        self.model, self.data, self.arm = model, mujoco.MjData(model), arm
        self.site = int(model.site(arm.site).id)
        joints = [int(model.joint(name).id) for name in arm.joints]
        self.qpos, self.dof = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
        self.low, self.high = model.jnt_range[joints].T
        self._jacobian = np.zeros((6, model.nv))

    def pose(self, joints: Float[np.ndarray, "J"]) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]]:
        """Where the hand is, and its axes as columns."""
        self.data.qpos[self.qpos] = joints
        mujoco.mj_kinematics(self.model, self.data)
        return self.data.site_xpos[self.site].copy(), self.data.site_xmat[self.site].reshape(3, 3).copy()

    def solve(
        self,
        pos: Float[np.ndarray, "3"],
        turn: Float[np.ndarray, "3 3"],
        near: Float[np.ndarray, "J"],
        iterations: int = 100,
        good: float = 2e-4,
    ) -> Float[np.ndarray, "J"]:
        """Joint positions for a hand at `pos` [m] with axes `turn`, found from `near`; the nearest within the joints' ranges."""
        q = np.clip(near, self.low, self.high)
        for _ in range(iterations):
            here, axes = self.pose(q)
            error = np.concatenate([pos - here, TURN * turn_between(axes, turn)])
            if np.linalg.norm(error) < good:
                break
            q = np.clip(q + np.clip(self._change(error, DAMPING), -MOST, MOST), self.low, self.high)
        return q

    def towards(
        self, joints: Float[np.ndarray, "J"], shift: Float[np.ndarray, "3"], turn: Float[np.ndarray, "3"]
    ) -> Float[np.ndarray, "J"]:
        """Changes of the joints, about `joints`, that move the hand by a small `shift` [m] and `turn` [rad]."""
        self.pose(joints)
        return self._change(np.concatenate([shift, TURN * turn]), 10.0 * DAMPING)

    def _change(self, error: np.ndarray, damping: float) -> np.ndarray:
        mujoco.mj_comPos(self.model, self.data)
        mujoco.mj_jacSite(self.model, self.data, self._jacobian[:3], self._jacobian[3:], self.site)
        jacobian = self._jacobian[:, self.dof] * np.array([1.0, 1.0, 1.0, TURN, TURN, TURN])[:, None]
        return jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + damping * np.eye(6), error)

    def off(self, joints: Float[np.ndarray, "J"], pos: Float[np.ndarray, "3"]) -> float:
        """How far the hand is from `pos` [m]."""
        return float(np.linalg.norm(self.pose(joints)[0] - pos))


def reachable(reach: Reach, pos: np.ndarray, turn: np.ndarray, near: np.ndarray, what: str) -> np.ndarray:
    """`solve`, and an error where it does not get within 5 mm.

    Raises:
        EdreamError: the place cannot be reached.
    """
    found = reach.solve(pos, turn, near)
    off = reach.off(found, pos)
    if off > 0.005:
        raise EdreamError(
            f"The arm {reach.arm.site!r} cannot reach {what} at {np.round(pos, 3).tolist()} m: {1000 * off:.0f} mm short."
        )
    return found


def turn_between(now: Float[np.ndarray, "3 3"], wanted: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3"]:
    """The turn that takes some axes to others, as a vector [rad]."""
    quat, turn = np.zeros(4), np.zeros(3)
    mujoco.mju_mat2Quat(quat, (wanted @ now.T).ravel())
    mujoco.mju_quat2Vel(turn, quat, 1.0)
    return turn
