"""The servo that drives a joint: found in a spec, and given the features of MuJoCo's PID actuator."""

from collections.abc import Sequence

import mujoco
import numpy as np
from jaxtyping import Float

from edream.core.effect import MEASURED_SUFFIX, MOTOR_SUFFIX, Fields, holds_position, joint_index
from edream.core.errors import EdreamError
from edream.core.parameters import Parameter

NO_INPUT = 16  # mjINPUT_NONE: a passive device
TURNED = np.pi / 2.0  # phase of a cogging without poles that makes a constant torque of its sine
PID = int(mujoco.mjtGain.mjGAIN_PID)


def servo(spec: mujoco.MjSpec, joint: str) -> mujoco.MjsActuator:
    """The actuator that a joint's commands go to.

    Raises:
        EdreamError: no actuator with an input drives the joint.
    """
    for actuator in spec.actuators:
        if actuator.target in (joint, joint + MOTOR_SUFFIX) and actuator.gaintype != mujoco.mjtGain.mjGAIN_DCMOTOR:
            return actuator
    raise EdreamError(f"Joint {joint!r} has no actuator of its own; effects act on actuated joints.")


def as_pid(spec: mujoco.MjSpec, joint: str) -> mujoco.MjsActuator:
    """Turn a joint's position servo into MuJoCo's `pid` with the same gains, whose slew limit and integral are off until set.

    `gainprm[0]` then holds ki, `dynprm` holds (imax, slewmax), and the position gain lives in `biasprm[1]` alone.

    Raises:
        EdreamError: the servo already has a filter, which a PID actuator cannot have.
    """
    actuator = servo(spec, joint)
    if actuator.gaintype == mujoco.mjtGain.mjGAIN_PID:
        return actuator
    if actuator.dyntype != mujoco.mjtDyn.mjDYN_NONE:
        raise EdreamError(f"Servo of joint {joint!r} has a filter; MuJoCo cannot give it a slew limit or an integral as well.")
    actuator.gaintype = mujoco.mjtGain.mjGAIN_PID
    actuator.dyntype = mujoco.mjtDyn.mjDYN_PID
    actuator.gainprm = np.zeros(len(actuator.gainprm))
    actuator.dynprm = np.zeros(len(actuator.dynprm))
    return actuator


def is_pid(model: mujoco.MjModel, actuator: int) -> bool:
    """Whether an actuator is MuJoCo's `pid`, whose `gainprm[0]` is ki."""
    return int(model.actuator_gaintype[actuator]) == PID


def passive_device(spec: mujoco.MjSpec, joint: str, kind: str) -> mujoco.MjsActuator:
    """Add a device without input to a joint, `<joint>_<kind>`; give it its law with `set_to_dcmotor(ctrlspec=NO_INPUT)`."""
    return spec.add_actuator(name=f"{joint}_{kind}", target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)


def device(model: mujoco.MjModel, joint: str, kind: str) -> int:
    """Number of the actuator that `passive_device` added."""
    return int(model.actuator(f"{joint}_{kind}").id)


def driven_joints(spec: mujoco.MjSpec) -> list[str]:
    """Names of the joints that take commands."""
    driven = [a.target for a in spec.actuators if a.gaintype != mujoco.mjtGain.mjGAIN_DCMOTOR]
    names = {joint.name for joint in spec.joints}
    links = [name.removesuffix(MOTOR_SUFFIX) for name in driven]
    return [link if link in names else name for link, name in zip(links, driven, strict=True)]


def read_by_sensors(spec: mujoco.MjSpec) -> None:
    """Give every driven joint that has none a sensor of its position, `<joint>_measured`."""
    named = {sensor.name for sensor in spec.sensors}
    for joint in driven_joints(spec):
        if joint + MEASURED_SUFFIX not in named:
            spec.add_sensor(
                name=joint + MEASURED_SUFFIX,
                type=mujoco.mjtSensor.mjSENS_JOINTPOS,
                objtype=mujoco.mjtObj.mjOBJ_JOINT,
                objname=joint,
            )


def geared_readings(model: mujoco.MjModel, joints: Sequence[str]) -> dict[str, int]:
    """Joints whose position is read through the gear of their servo, and the servo's number: the joint is at reading / gear."""
    out = {}
    for joint in joints:
        sensor = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SENSOR, joint + MEASURED_SUFFIX)
        if sensor >= 0 and int(model.sensor_type[sensor]) == int(mujoco.mjtSensor.mjSENS_ACTUATORPOS):
            out[joint] = int(model.sensor_objid[sensor])
    return out


def places(model: mujoco.MjModel, joints: Sequence[str], readings: Float[np.ndarray, "T J"]) -> Float[np.ndarray, "T J"]:
    """Where joints stand [rad or m] when their encoders read this, which a gear at the encoder makes another number."""
    gears = geared_readings(model, joints)
    factor = [float(model.actuator_gear[gears[joint], 0]) if joint in gears else 1.0 for joint in joints]
    return readings / np.array(factor)


def asked_positions(model: mujoco.MjModel, joints: Sequence[str], commands: Float[np.ndarray, "T J"]) -> Float[np.ndarray, "T J"]:
    """Commands [rad or m]; NaN for joints whose actuators take a torque or a speed, which no position can be held against."""
    return np.where([holds_position(model, joint) for joint in joints], commands, np.nan)


def damping_inside(model: mujoco.MjModel, targets: Sequence[str]) -> Parameter:
    """What share of a joint's damping is the servo's, and so within its limits: as published, give or take."""
    return Parameter("inside", "1", 0.0, 1.0, max(_published_share(model, target) for target in targets), spread=0.2)


def share_within_limit(model: mujoco.MjModel, joint: str) -> float:
    """What share of a joint's damping counts towards the limit of its servo's torque, as published; 0 where there is no limit."""
    actuator = joint_index(model, joint)["actuator"]
    limited = model.actuator_forcelimited[actuator] or model.jnt_actfrclimited[model.actuator_trnid[actuator, 0]]
    return _published_share(model, joint) if limited else 0.0


def _published_share(model: mujoco.MjModel, joint: str) -> float:
    index = joint_index(model, joint)
    published = -float(model.actuator_biasprm[index["actuator"], 2])
    return min(published / max(published + float(model.dof_damping[index["drive"]]), 1e-12), 1.0)


def merge_damping(fields: Fields, joint: str, damping: Float[np.ndarray, "N"]) -> None:
    """Write one number for the damping of a joint and its servo [N m s/rad]; what counts towards a limit stays with the servo."""
    _split(fields, joint, damping, share_within_limit(fields.model, joint))
    fields.merged.add(joint)


def share_damping(fields: Fields, joint: str, inside: Float[np.ndarray, "N"]) -> None:
    """Give the servo its share of a joint's damping, where one number for both was written.

    What the servo damps is part of its torque, and so within its limits; what the joint damps is not.
    """
    if joint in fields.merged:
        index = joint_index(fields.model, joint)
        both = fields["dof_damping"][:, index["drive"]] - fields["actuator_biasprm"][:, index["actuator"], 2]
        _split(fields, joint, both, inside)


def part_damping(fields: Fields, joint: str, servos: Float[np.ndarray, "N"]) -> None:
    """Write the servo's own damping [N m s/rad]; where one number for both was written, that is the joint's from here on."""
    share_damping(fields, joint, np.zeros(fields.count))
    fields.merged.discard(joint)
    fields["actuator_biasprm"][:, joint_index(fields.model, joint)["actuator"], 2] = -servos


def _split(fields: Fields, joint: str, damping: Float[np.ndarray, "N"], inside: Float[np.ndarray, "N"] | float) -> None:
    index = joint_index(fields.model, joint)
    fields["actuator_biasprm"][:, index["actuator"], 2] = -damping * inside
    fields["dof_damping"][:, index["drive"]] = damping * (1.0 - inside)
