"""How large torques and speeds are on a joint: the yardstick for bounds that suit any robot."""

from collections.abc import Sequence
from weakref import WeakKeyDictionary

import mujoco
import numpy as np

from edream.core.effect import joint_index

JOINT_DRIVES = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
POSES = 24
BRISK_ACCELERATION = 20.0  # rad/s^2: what a brisk servo move asks of a joint
BANDWIDTH = 30.0  # rad/s, of a usual position servo
SEEN = 0.015  # rad of error that a torque may well make
HALF = 0.5  # of a servo's limit
STUCK = 0.1  # rad of error that dry friction may hold
FOLLOWS_FROM = (
    "qpos0", "jnt_range", "jnt_limited", "jnt_pos", "jnt_axis", "body_pos", "body_quat", "body_mass", "body_inertia", "body_ipos",
    "body_iquat", "dof_armature", "actuator_biasprm",
)  # fmt: skip
_ASKED: WeakKeyDictionary[mujoco.MjModel, dict[tuple[str, bytes], float]] = WeakKeyDictionary()


def torque_scale(model: mujoco.MjModel, joint: str) -> float:
    """A large torque for this joint [N m]: the heaviest gravity load over sampled poses plus that of a brisk acceleration.

    Where the model leaves the motor's rotor out, its inertia is guessed: at the end of an arm it is most of what there is.
    A model is asked once for each joint, as long as what this follows from stays as it is.
    """
    asked = _ASKED.setdefault(model, {})
    key = (joint, b"".join(np.asarray(getattr(model, field)).tobytes() for field in FOLLOWS_FROM) + model.opt.gravity.tobytes())
    if key not in asked:
        asked[key] = _torque_scale(model, joint)
    return asked[key]


def _torque_scale(model: mujoco.MjModel, joint: str) -> float:
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
    return gravity + BRISK_ACCELERATION * (inertia + rotor_guess(model, joint))


def rotor_guess(model: mujoco.MjModel, joint: str) -> float:
    """Inertia of a rotor that the model leaves out [kg m^2]: that with which its position servo is as quick as most are.

    0 where the model has a rotor, or the joint no position servo.
    """
    stiffness = position_gain(model, joint)
    return 0.0 if float(model.dof_armature[joint_index(model, joint)["drive"]]) > 0.0 else stiffness / BANDWIDTH**2


def position_gain(model: mujoco.MjModel, joint: str) -> float:
    """Gain of a joint's position servo [N m/rad]; 0 where it has none."""
    return max(0.0, -float(model.actuator_biasprm[joint_index(model, joint)["actuator"], 1]))


def most_friction(model: mujoco.MjModel, joints: Sequence[str]) -> float:
    """The most dry friction that joints which share their numbers may have [N m].

    A model without rotors was not made from the drives, so that its friction says little, either: as much then as would hold the
    servo at an error of 0.1 rad.
    """
    unmodelled = [STUCK * position_gain(model, joint) for joint in joints if rotor_guess(model, joint) > 0.0]
    nominal = float(model.dof_frictionloss[joint_index(model, joints[0])["drive"]])
    return max(5.0 * nominal, most_torque(model, joints), *unmodelled)


def most_torque(model: mujoco.MjModel, joints: Sequence[str]) -> float:
    """The most that an effect may take on joints that share their numbers [N m].

    A large torque, or what moves a stiff servo by little more than can be seen, where its limit allows as much.
    """
    held = [min(SEEN * position_gain(model, joint), HALF * strongest(model, joint)) for joint in joints]
    return max(largest(model, joints), *held)


def last_driven(model: mujoco.MjModel, body: int) -> str | None:
    """The joint with a servo that is nearest before a body; None where none is."""
    servos = np.isin(model.actuator_trntype, JOINT_DRIVES) & (model.actuator_ctrlnum > 0)
    while body:
        for joint in range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body]):
            if joint in model.actuator_trnid[servos, 0]:
                return str(model.joint(joint).name)
        body = int(model.body_parentid[body])
    return None


def largest(model: mujoco.MjModel, joints: Sequence[str]) -> float:
    """The largest `torque_scale` among joints that share their numbers [N m]."""
    return max(torque_scale(model, joint) for joint in joints)


def travel(model: mujoco.MjModel, joint: str) -> tuple[float, float]:
    """Range of a joint [rad], half a turn to each side where it has none."""
    number = model.joint(joint).id
    low, high = model.jnt_range[number] if model.jnt_limited[number] else (-np.pi, np.pi)
    return float(low), float(high)


def strongest(model: mujoco.MjModel, joint: str) -> float:
    """The largest torque that a joint's servo can give [N m]: the servo's or the joint's limit, or that of an error of 1.5 rad."""
    actuator, number = joint_index(model, joint)["actuator"], model.joint(joint).id
    limits = [model.actuator_forcerange[actuator, 1]] if model.actuator_forcelimited[actuator] else []
    limits += [model.jnt_actfrcrange[number, 1]] if model.jnt_actfrclimited[number] else []
    return float(min(limits)) if limits else max(10.0 * torque_scale(model, joint), 1.5 * position_gain(model, joint))
