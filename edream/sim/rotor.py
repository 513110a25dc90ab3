"""A motor of its own behind a joint: where a gear's give and play go."""

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from edream.core.effect import MOTOR_SUFFIX, Fields, State
from edream.core.parameters import Parameter
from edream.sim.friction import hold_still
from edream.sim.scales import largest
from edream.sim.servo import servo

GEAR_SUFFIX = "_gear"
LINK_SHARE = 0.1  # of the armature stays on the link (output shaft), so that light links keep a stable gear
STABLE = 0.3  # of reduced inertia / step^2: the stiffest spring that explicit integration carries
RIGID = 0.9999
BEARINGS = 0.05  # of a large torque: what the bearings behind a gear may hold where nothing is known of them yet
BARE = 0.02  # of the inertia at a joint: what a rotor is taken to have where the model gives the joint no armature


def add_rotor(spec: mujoco.MjSpec, joint: str) -> mujoco.MjsTendon:
    """Put a rotor `<joint>_motor` between a joint's servo and its link; what is measured stays the link.

    Armature, damping and dry friction move to the rotor, a massless body on the same axis. Three things tie it to the link: a fixed
    tendon `<joint>_gear` of length link - motor, which effects give stiffness or a range, and an equality `<joint>_gear` that locks
    both together until an effect opens it. Adding it twice changes nothing. Where the model gives no armature, a rotor of `BARE` of
    the joint's inertia comes on top. Keyframes are dropped: their size no longer fits.

    Returns:
        The tendon.
    """
    motor, gear = joint + MOTOR_SUFFIX, joint + GEAR_SUFFIX
    for tendon in spec.tendons:
        if tendon.name == gear:
            return tendon
    link = spec.joint(joint)
    inertia = link.armature if link.armature > 0.0 else bare_rotor(spec.copy().compile(), joint)
    carrier = link.parent.parent.add_body(name=motor, pos=link.parent.pos, quat=link.parent.quat, mass=1e-6, inertia=[1e-9] * 3)
    carrier.explicitinertial, carrier.ipos = True, np.zeros(3)  # MuJoCo writes no inertial without a place
    for kind in ("axisangle", "xyaxes", "zaxis", "euler", "type"):
        setattr(carrier.alt, kind, getattr(link.parent.alt, kind))
    rotor = carrier.add_joint(name=motor, type=link.type, pos=link.pos, axis=link.axis, ref=link.ref)
    rotor.armature, link.armature = (1.0 - LINK_SHARE) * inertia, LINK_SHARE * inertia
    rotor.damping, link.damping = link.damping, np.zeros(3)
    rotor.frictionloss, link.frictionloss = link.frictionloss, 0.0
    rotor.solref_friction, rotor.solimp_friction = link.solref_friction, link.solimp_friction
    hold_still(spec, joint)
    keep_range(spec, servo(spec, joint))
    servo(spec, joint).target = motor
    for key in list(spec.keys):
        spec.delete(key)
    tendon = spec.add_tendon(name=gear, springlength=[0.0, 0.0])
    tendon.wrap_joint(joint, 1.0)
    tendon.wrap_joint(motor, -1.0)
    lock = spec.add_equality(name=gear, type=mujoco.mjtEq.mjEQ_JOINT, name1=joint, name2=motor, objtype=mujoco.mjtObj.mjOBJ_JOINT)
    lock.data = [0.0, 1.0] + [0.0] * (len(lock.data) - 2)
    lock.solref = [2.0 * spec.option.timestep, 1.0]
    lock.solimp = [RIGID, RIGID, 0.001, 0.5, 2.0]
    return tendon


def keep_range(spec: mujoco.MjSpec, actuator: Any) -> None:
    """Write down the range of commands [rad or m] that an actuator takes over from its joint (`inheritrange`): a rotor has none."""
    if actuator.inheritrange > 0.0:
        number = [one.target for one in spec.actuators].index(actuator.target)
        actuator.ctrlrange, actuator.inheritrange = spec.copy().compile().actuator_ctrlrange[number], 0.0
        actuator.ctrllimited = mujoco.mjtLimited.mjLIMITED_TRUE


def drive_joint(spec: mujoco.MjSpec, joint: str) -> str:
    """The joint on which the motor's friction acts: the rotor's where there is one."""
    return joint + MOTOR_SUFFIX if spec.joint(joint + MOTOR_SUFFIX) is not None else joint


def open_gear(fields: Fields, joint: str, is_open: np.ndarray) -> None:
    """Unlock the gear in those simulations where `is_open`, (N,)."""
    fields["eq_active0"][is_open, fields.model.equality(joint + GEAR_SUFFIX).id] = 0


def gear_feedback(state: State, index: dict[str, int], values: dict[str, Any]) -> None:
    """The servo follows, by a share, the encoder behind its gear; by no more than a shaft that gives can hold."""
    gain = np.minimum(state.gain[:, index["actuator"]], 0.9 / np.maximum(values.get("give", 0.0), 1e-9))
    twist = state.qpos[:, index["drive_qpos"]] - state.qpos[:, index["qpos"]]
    state.torque[:, index["drive"]] += state.let_through(index, values["feedback"] * gain * twist)


def behind(model: mujoco.MjModel, targets: Sequence[str]) -> tuple[Parameter, ...]:
    """What else is unknown where a gear is open: whose position the servo follows, and how the bearings behind the gear rub."""
    high = largest(model, targets)
    return (Parameter("feedback", "1", 0.0, 1.0, 0.0), Parameter("bearing", "N m", 0.0, high, BEARINGS * high))


def write_bearing(fields: Fields, joint: str, torque: np.ndarray, is_open: np.ndarray) -> None:
    """Dry friction of the link itself [N m], (N,), in those simulations whose gear is open."""
    fields["dof_frictionloss"][:, int(fields.model.joint(joint).dofadr[0])] = np.where(is_open, torque, 0.0)


def wind_up(model: Any, qpos: Any, load: Any, stiffness: Any, limits: Any, rest: Any, locked: Any) -> None:
    """Turn each motor behind an open gear until the gear carries what holds its link where it is.

    A shaft that gives is twisted by its load, and play is taken up on the side that the load presses on: a replay that began with
    the motor straight behind its link would let the link drop first. It is written into emitted hook files as it stands.

    Args:
        model: the model.
        qpos: positions (N, nq), every motor at its link; motors are written.
        load: what each joint must hold [N m], (N, nv): `qfrc_bias` less `qfrc_passive` there.
        stiffness, limits, rest: `tendon_stiffness` (N, nt), `tendon_range` and `tendon_lengthspring` (N, nt, 2).
        locked: `eq_active`, (N, neq).
    """
    names = [model.joint(number).name for number in range(model.njnt)]
    for joint, name in enumerate(names):
        tendon = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_TENDON, name + "_gear")
        if tendon < 0 or name + "_motor" not in names:
            continue
        motor, torque = names.index(name + "_motor"), load[:, model.jnt_dofadr[joint]]
        edge = (limits if model.tendon_limited[tendon] else rest)[:, tendon, 1]
        give = np.where(stiffness[:, tendon] > 0.0, torque / np.maximum(stiffness[:, tendon], 1e-12), 0.0)
        twist = np.where(locked[:, model.equality(name + "_gear").id] > 0, 0.0, give + edge * np.sign(torque))
        qpos[:, model.jnt_qposadr[motor]] = qpos[:, model.jnt_qposadr[joint]] + twist


def gear_limit(model: mujoco.MjModel, joint: str) -> float:
    """The stiffest gear that stays stable at this model's time step [N m/rad], of the model as published or with its rotor."""
    number = model.joint(joint + MOTOR_SUFFIX if has_rotor(model, joint) else joint).id
    inertia = float(model.dof_armature[model.jnt_dofadr[number]]) / ((1.0 - LINK_SHARE) if has_rotor(model, joint) else 1.0)
    inertia = inertia if inertia > 0.0 else bare_rotor(model, joint)
    inside = 0.0 if has_rotor(model, joint) else (1.0 - LINK_SHARE) * inertia
    link = max(float(model.dof_M0[model.jnt_dofadr[model.joint(joint).id]]) - inside, 1e-9)
    rotor = (1.0 - LINK_SHARE) * inertia
    return STABLE / float(model.opt.timestep) ** 2 * link * rotor / (link + rotor)


def bare_rotor(model: mujoco.MjModel, joint: str) -> float:
    """The inertia that a rotor is taken to have behind a joint without armature [kg m^2]."""
    return BARE * float(model.dof_M0[model.jnt_dofadr[model.joint(joint).id]])


def has_rotor(model: mujoco.MjModel, joint: str) -> bool:
    """Whether a joint's motor has a degree of freedom of its own."""
    return mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, joint + MOTOR_SUFFIX) >= 0
