"""Where two models of one robot have its links while their encoders read the same."""

import mujoco
import numpy as np
from jaxtyping import Float

from edream.sim.followers import Followers
from edream.sim.robot import RobotModel
from edream.sim.servo import places

SAME = 1e-6  # m, or of a rotation matrix: what rounding the numbers of a file may come to


def stand_alike(robot: RobotModel, other: RobotModel, readings: Float[np.ndarray, "T J"]) -> bool:
    """Whether the links of both stand at the same places, so that no camera sees a difference.

    Args:
        robot, other: two models with the same joints; links that only one of them has do not count.
        readings: what the encoders say [rad or m], in the order of the robot's joints.
    """
    names = [robot.model.body(body).name for body in range(1, robot.model.nbody)]
    there = {other.model.body(body).name for body in range(1, other.model.nbody)}
    shared = [name for name in names if name and name in there]
    return bool(np.allclose(_stood(robot, shared, readings), _stood(other, shared, readings), rtol=0.0, atol=SAME))


def _stood(robot: RobotModel, links: list[str], readings: Float[np.ndarray, "T J"]) -> Float[np.ndarray, "T L 12"]:
    """Place and orientation of links at each reading."""
    model, data = robot.model, mujoco.MjData(robot.model)
    bodies = [int(model.body(link).id) for link in links]
    where = [int(model.joint(joint).qposadr[0]) for joint in robot.joints]
    followers, rows = Followers(model, robot.joints), []
    for row in places(model, robot.joints, readings):
        data.qpos[where] = row
        followers.place(data.qpos)
        mujoco.mj_kinematics(model, data)
        rows.append(np.concatenate([data.xpos[bodies], data.xmat[bodies]], axis=1))
    return np.array(rows)
