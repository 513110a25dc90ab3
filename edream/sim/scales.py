"""How large torques and speeds are on a joint: the yardstick for bounds that suit any robot."""

from collections.abc import Sequence

import mujoco
import numpy as np

from edream.core.effect import joint_index

POSES = 24
BRISK_ACCELERATION = 20.0  # rad/s^2: what a brisk servo move asks of a joint


def torque_scale(model: mujoco.MjModel, joint: str) -> float:
    """A large torque for this joint [N m]: the heaviest gravity load over sampled poses plus that of a brisk acceleration."""
    number = model.joint(joint).id
    dof = int(model.jnt_dofadr[number])
    data = mujoco.MjData(model)
    rng = np.random.default_rng(0)
    gravity = inertia = 0.0
    for _ in range(POSES):
        data.qpos[:] = model.qpos0
        for j in range(model.njnt):
            if model.jnt_type[j] in (2, 3):
                low, high = model.jnt_range[j] if model.jnt_limited[j] else (-1.5, 1.5)
                data.qpos[model.jnt_qposadr[j]] = rng.uniform(low, high)
        mujoco.mj_forward(model, data)
        gravity = max(gravity, abs(float(data.qfrc_bias[dof])))
        dense = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, dense)
        inertia = max(inertia, float(dense[dof, dof]))
    return gravity + BRISK_ACCELERATION * inertia


def largest(model: mujoco.MjModel, joints: Sequence[str]) -> float:
    """The largest `torque_scale` among joints that share their numbers [N m]."""
    return max(torque_scale(model, joint) for joint in joints)


def travel(model: mujoco.MjModel, joint: str) -> tuple[float, float]:
    """Range of a joint [rad], half a turn to each side where it has none."""
    number = model.joint(joint).id
    low, high = model.jnt_range[number] if model.jnt_limited[number] else (-np.pi, np.pi)
    return float(low), float(high)


def strongest(model: mujoco.MjModel, joint: str) -> float:
    """The largest torque that a joint's servo can give [N m]: its limit, or without one that of an error of 1.5 rad."""
    actuator = joint_index(model, joint)["actuator"]
    if model.actuator_forcelimited[actuator]:
        return float(model.actuator_forcerange[actuator, 1])
    return max(10.0 * torque_scale(model, joint), -1.5 * float(model.actuator_biasprm[actuator, 1]))
