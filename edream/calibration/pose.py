"""End-effector errors: translation [m] and rotation [rad] between measured and simulated joint positions."""

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import mujoco
import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from edream.core.effect import joint_index
from edream.sim.mass import last_body
from edream.sim.robot import RobotModel


@dataclass(frozen=True, eq=False)
class Chain:
    """The joints between the base and the end effector, for many poses at once.

    Attributes:
        robot: the published model.
    """

    robot: RobotModel

    @cached_property
    def links(self) -> list[int]:
        """Bodies from the base to the end effector."""
        model = self.robot.model
        body = int(model.site_bodyid[model.site(self.robot.site).id]) if self.robot.site else last_body(model)
        chain = []
        while body:
            chain.append(body)
            body = int(model.body_parentid[body])
        return chain[::-1]

    @property
    def end(self) -> str:
        """What counts as the end effector, in words."""
        if self.robot.site:
            return f"site {self.robot.site}"
        return f"body {self.robot.model.body(self.links[-1]).name or self.links[-1]}, the last; robot.site=NAME chooses a site"

    def poses(self, positions: Float[np.ndarray, "T J"]) -> tuple[Float[np.ndarray, "T 3"], Rotation]:
        """Position [m] and rotation of the end effector in the base frame. Joints outside the chain do not matter.

        Args:
            positions: joint positions [rad or m], in the order of `robot.joints`.
        """
        model, count = self.robot.model, len(positions)
        columns = {joint_index(model, name)["joint"]: i for i, name in enumerate(self.robot.joints)}
        where, turn = np.zeros((count, 3)), Rotation.identity(count)
        for body in self.links:
            where = where + turn.apply(model.body_pos[body])
            turn = turn * _rotation(model.body_quat[body])
            for joint in range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body]):
                if joint not in columns:
                    continue
                moved = positions[:, columns[joint]] - model.qpos0[model.jnt_qposadr[joint]]
                axis, anchor = model.jnt_axis[joint], model.jnt_pos[joint]
                if model.jnt_type[joint] == int(mujoco.mjtJoint.mjJNT_SLIDE):
                    where = where + turn.apply(moved[:, None] * axis)
                    continue
                pivot = where + turn.apply(anchor)
                turn = turn * Rotation.from_rotvec(moved[:, None] * axis)
                where = pivot - turn.apply(anchor)
        if self.robot.site:
            site = model.site(self.robot.site).id
            return where + turn.apply(model.site_pos[site]), turn * _rotation(model.site_quat[site])
        return where, turn


def pose_error(
    chain: Chain,
    simulated: Float[np.ndarray, "T J"],
    measured: Float[np.ndarray, "T J"],
    form: Literal["geodesic", "arcsin"] = "geodesic",
) -> tuple[Float[np.ndarray, "T"], Float[np.ndarray, "T"]]:
    """Distance [m] and angle [rad] between simulated and measured end-effector poses.

    geodesic: angle of R_sim R_meas'. arcsin: SimplerEnv's arcsin(|R_sim - R_meas|_F / (2 sqrt 2)), which is half of it.
    """
    (a, turn_a), (b, turn_b) = chain.poses(simulated), chain.poses(measured)
    angle = (turn_a.inv() * turn_b).magnitude()
    return np.linalg.norm(a - b, axis=1), angle if form == "geodesic" else angle / 2


def _rotation(quat: np.ndarray) -> Rotation:
    return Rotation.from_quat(np.roll(quat, -1))
