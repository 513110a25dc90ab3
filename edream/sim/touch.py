"""Whether a robot touches anything in its recordings: where it never does, searches need not look for contacts."""

import copy
from collections.abc import Sequence
from dataclasses import replace

import mujoco

from edream.core.effect import joint_index
from edream.core.episode import Episode
from edream.sim.followers import Followers
from edream.sim.robot import RobotModel

POSES = 20_000  # looked at, spread evenly over all recordings
NEAR = 0.005  # m: between two rows, or beside what an encoder says, so much may be closed


def kept_clear(robot: RobotModel, episodes: Sequence[Episode]) -> RobotModel:
    """The robot, marked as clear where none of its geoms touches another in the measured poses.

    A model that moves in more ways than were recorded, or than follow from that (a free object, a gripper without an encoder), is
    never marked.
    """
    return replace(robot, clear=never_touches(robot, episodes))


def never_touches(robot: RobotModel, episodes: Sequence[Episode]) -> bool:
    """Whether MuJoCo finds no two geoms touching in the measured poses, nor near each other but those that always are."""
    if not episodes:
        return False
    model = copy.copy(robot.model)
    followers = Followers(model, episodes[0].joints)
    if model.nq != len(episodes[0].joints) + len(followers.joints):
        return False
    model.geom_margin[:] = NEAR
    data = mujoco.MjData(model)
    columns = [joint_index(model, joint)["qpos"] for joint in episodes[0].joints]
    every = max(1, sum(len(episode.position) for episode in episodes) // POSES)
    near: set[frozenset[int]] | None = None
    for episode in episodes:
        for pose in episode.position[::every]:
            data.qpos[columns] = pose
            followers.place(data.qpos)
            mujoco.mj_fwdPosition(model, data)
            pairs = {frozenset((int(one.geom1), int(one.geom2))) for one in data.contact}
            near = pairs if near is None else near
            if pairs != near or any(one.dist <= 0.0 for one in data.contact):
                return False
    return True
