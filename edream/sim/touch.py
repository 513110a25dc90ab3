"""Whether a robot touches anything in its recordings: where it never does, searches need not look for contacts."""

from collections.abc import Sequence
from dataclasses import replace

import mujoco

from edream.core.effect import joint_index
from edream.core.episode import Episode
from edream.sim.robot import RobotModel

POSES = 2000  # looked at, spread evenly over all recordings


def kept_clear(robot: RobotModel, episodes: Sequence[Episode]) -> RobotModel:
    """The robot, marked as clear where none of its geoms touches another in any measured pose.

    A model that moves in more ways than were recorded (a free object, a gripper without an encoder) is never marked.
    """
    return replace(robot, clear=never_touches(robot, episodes))


def never_touches(robot: RobotModel, episodes: Sequence[Episode]) -> bool:
    """Whether MuJoCo finds no contact in the measured poses."""
    model = robot.model
    if not episodes or model.nq != len(episodes[0].joints):
        return False
    data = mujoco.MjData(model)
    columns = [joint_index(model, joint)["qpos"] for joint in episodes[0].joints]
    every = max(1, sum(len(episode.position) for episode in episodes) // POSES)
    for episode in episodes:
        for pose in episode.position[::every]:
            data.qpos[columns] = pose
            mujoco.mj_fwdPosition(model, data)
            if data.ncon:
                return False
    return True
