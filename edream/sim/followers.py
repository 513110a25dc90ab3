"""Joints that no recording shows but that equalities tie to recorded ones, such as the second finger of a gripper."""

from collections.abc import Sequence

import mujoco
import numpy as np
from jaxtyping import Float

from edream.core.effect import MOTOR_SUFFIX

ITERATIONS = 30
CLOSED = 1e-10  # rad or m: a step that small ends the search


class Followers:
    """Puts such joints where a model's equalities ask for them: equal joints, tendons and closed chains alike.

    A replay that began with them elsewhere would tear at the recorded joints, and a picture would show a finger that stays behind.

    Args:
        model: the robot.
        joints: those that the recordings show; motors behind their gears count as shown.
    """

    def __init__(self, model: mujoco.MjModel, joints: Sequence[str]) -> None:
        shown = {*joints, *(joint + MOTOR_SUFFIX for joint in joints)}
        self.model, self.data = model, mujoco.MjData(model) if model.neq else None
        free = [j for j in range(model.njnt) if model.joint(j).name not in shown]
        self._dofs = np.flatnonzero(np.isin(model.dof_jntid, free))
        self.joints = self._tied() if self.data is not None else []

    def _tied(self) -> list[str]:
        assert self.data is not None
        jacobian = self._violated(self.model.qpos0)[1]
        moved = self._dofs[np.any(jacobian[:, self._dofs] != 0.0, axis=0)]
        return [self.model.joint(j).name for j in sorted({int(self.model.dof_jntid[dof]) for dof in moved})]

    def place(self, qpos: Float[np.ndarray, "Q"], qvel: Float[np.ndarray, "V"] | None = None) -> None:
        """Write the positions of the joints that follow [rad or m], and their speeds [rad/s or m/s]; those that are shown stay.

        Gauss-Newton from where they are; where equalities cannot all be met, as near as may be. Source: the positions and Jacobians
        of constraints, MuJoCo documentation, Computation, "Equality".
        """
        if not self.joints:
            return
        for _ in range(ITERATIONS):
            error, jacobian = self._violated(qpos)
            step = np.zeros(self.model.nv)
            step[self._dofs] = np.linalg.lstsq(jacobian[:, self._dofs], -error, rcond=None)[0]
            mujoco.mj_integratePos(self.model, qpos, step, 1.0)
            if np.abs(step).max() < CLOSED:
                break
        if qvel is not None:
            jacobian = self._violated(qpos)[1]
            qvel[self._dofs] = 0.0
            qvel[self._dofs] = np.linalg.lstsq(jacobian[:, self._dofs], -jacobian @ qvel, rcond=None)[0]

    def _violated(self, qpos: np.ndarray) -> tuple[Float[np.ndarray, "E"], Float[np.ndarray, "E V"]]:
        """By how much each equality is off, and how that changes with the joints."""
        model, data = self.model, self.data
        assert data is not None
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_tendon(model, data)
        mujoco.mj_makeConstraint(model, data)
        if mujoco.mj_isSparse(model):
            jacobian = np.zeros((data.nefc, model.nv))
            mujoco.mju_sparse2dense(jacobian, data.efc_J, data.efc_J_rownnz, data.efc_J_rowadr, data.efc_J_colind)
        else:
            jacobian = data.efc_J.reshape(data.nefc, model.nv)
        return data.efc_pos[: data.ne].copy(), jacobian[: data.ne].copy()
