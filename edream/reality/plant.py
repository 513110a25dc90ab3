"""The make-believe robot's numbers, its state within a step, and what a hidden effect may change."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

import mujoco
import numpy as np
from jaxtyping import Float

from edream.core.errors import EdreamError
from edream.reality.dynamics import Tree, tree_of

NUISANCE = ("kp", "kd", "damping", "frictionloss", "armature")


@dataclass(frozen=True, eq=False)
class Plant:
    """Every number of the robot; arrays are (J,), in joint order, SI.

    Attributes:
        kp, kd: position and velocity gain of the servo.
        damping, frictionloss, armature: as the nominal model means them.
        stiffness, rest: nominal parallel spring and its rest position.
        limit: largest servo torque, infinite where there is none.
        ratio, offset: what the encoder says of a position q: ratio q + offset. The servo believes it.
        give: stiffness of the shaft between motor and link, infinite where rigid.
        give_damping: damping of that shaft.
        gap: half width of the dead zone in that shaft.
        sees: whether encoder and servo sit on the link or on the motor side of that shaft.
        smooth: speed [rad/s] over which dry friction comes up, so that a stuck joint creeps; 0 where it holds.
    """

    joints: tuple[str, ...]
    tree: Tree
    gravity: np.ndarray
    kp: np.ndarray
    kd: np.ndarray
    damping: np.ndarray
    frictionloss: np.ndarray
    armature: np.ndarray
    stiffness: np.ndarray
    rest: np.ndarray
    limit: np.ndarray
    ratio: np.ndarray
    offset: np.ndarray
    give: np.ndarray
    give_damping: np.ndarray
    gap: np.ndarray
    sees: Literal["link", "motor"] = "link"
    smooth: float = 0.0

    def with_values(self, **arrays: np.ndarray) -> "Plant":
        """A plant with other numbers."""
        return replace(self, **arrays)


@dataclass(eq=False)
class Moment:
    """Where the robot is in the middle of a step; arrays are (M, J).

    Attributes:
        time: seconds since the recording began.
        step: length of a step [s].
        q, v: position and velocity of the links.
        theta, w: position and velocity of the motors, in joint units; those of the links where the shaft is rigid.
        error: command minus encoder.
        load: torque that the gears pass on to the links, as of the last step.
    """

    time: float
    step: float
    q: Float[np.ndarray, "M J"]
    v: Float[np.ndarray, "M J"]
    theta: Float[np.ndarray, "M J"]
    w: Float[np.ndarray, "M J"]
    error: Float[np.ndarray, "M J"]
    load: Float[np.ndarray, "M J"]


class Term:
    """One hidden effect at work on one run; a subclass overrides what it changes and leaves the rest.

    Attributes:
        link_side: whether `passive` acts on the links rather than on the motors.
        cuts: whether `drive` cuts the torque off, so that within a step it no longer follows the motion.
    """

    link_side = False
    cuts = False

    def __init__(self, values: Mapping[str, float], on: Float[np.ndarray, "J"], other: int = -1) -> None:
        """Values by name; 1 in `on` for each joint it acts on; a second joint where one is needed."""
        self.values = values
        self.on = on
        self.other = other

    def of(self, name: str) -> Float[np.ndarray, "J"]:
        """One value, at the joints that it acts on, and 0 elsewhere."""
        return self.on * self.values[name]

    def plant(self, plant: Plant) -> Plant:
        """Other numbers for the robot."""
        return plant

    def setpoint(self, command: Float[np.ndarray, "S M J"], step: float) -> Float[np.ndarray, "S M J"]:
        """What the servo makes of the commands, one row a step."""
        return command

    def start(self, shape: tuple[int, int]) -> None:
        """Set inner states to rest, for (M, J) joints."""

    def error(self, error: np.ndarray, now: Moment) -> np.ndarray:
        """What the servo takes for its error."""
        return error

    def drive(self, torque: np.ndarray, now: Moment) -> np.ndarray:
        """Servo torque after this effect."""
        return torque

    def passive(self, now: Moment) -> np.ndarray | None:
        """Torque added to each joint, or None."""
        return None

    def dry(self, up: np.ndarray, down: np.ndarray, now: Moment) -> tuple[np.ndarray, np.ndarray]:
        """Largest dry friction against positive and against negative motion."""
        return up, down

    def record(self, position: np.ndarray, times: np.ndarray) -> np.ndarray:
        """What the recorder gets for one motion's encoder values, (S, J), at `times`, (S,)."""
        return position


def nominal_plant(model: mujoco.MjModel) -> Plant:
    """The robot exactly as its model says.

    Raises:
        EdreamError: an actuator is not a plain position servo on a joint, with gear 1.
    """
    tree = tree_of(model)
    size = model.nv
    kp, kd, limit = np.zeros(size), np.zeros(size), np.full(size, np.inf)
    for actuator in range(model.nu):
        gain, bias = model.actuator_gainprm[actuator, 0], model.actuator_biasprm[actuator]
        name = model.actuator(actuator).name
        if gain <= 0 or bias[1] != -gain or model.actuator_gear[actuator, 0] != 1.0:
            raise EdreamError(f"The make-believe robot needs position servos with gear 1; actuator {name!r} is not one.")
        joint = int(model.actuator_trnid[actuator, 0])
        kp[joint], kd[joint] = gain, -bias[2]
        if model.actuator_forcelimited[actuator]:
            low, high = model.actuator_forcerange[actuator]
            limit[joint] = min(-low, high)
    if model.nu != size:
        raise EdreamError(f"The make-believe robot needs one actuator for each joint, not {model.nu} for {size}.")
    return Plant(
        joints=tuple(model.joint(joint).name for joint in range(size)),
        tree=tree,
        gravity=model.opt.gravity.copy(),
        kp=kp,
        kd=kd,
        damping=model.dof_damping.reshape(size, -1)[:, 0].copy(),
        frictionloss=model.dof_frictionloss.copy(),
        armature=model.dof_armature.copy(),
        stiffness=model.jnt_stiffness.reshape(size, -1)[:, 0].copy(),
        rest=model.qpos_spring.copy(),
        limit=limit,
        ratio=np.ones(size),
        offset=np.zeros(size),
        give=np.full(size, np.inf),
        give_damping=np.zeros(size),
        gap=np.zeros(size),
    )
