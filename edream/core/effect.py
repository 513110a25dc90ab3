"""A physical effect: what it is called, what is unknown about it, and how MuJoCo is told."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal, Protocol

import numpy as np
from jaxtyping import Float

from edream.core.errors import EdreamError
from edream.core.parameters import Parameter

if TYPE_CHECKING:
    import mujoco

Place = Literal["joint", "pair", "body", "world", "geom"]
Values = Mapping[str, Float[np.ndarray, "N"]]


class Fields(Protocol):
    """Model fields of N simulations of one compiled model, each (N, ...) and written in place.

    Attributes:
        merged: joints whose damping was written as one number for the joint and its servo.
    """

    model: mujoco.MjModel
    count: int
    merged: set[str]

    def __getitem__(self, name: str) -> Float[np.ndarray, "N ..."]:
        """The live values of a `mujoco.MjModel` field, such as "dof_damping", or of an option, such as "opt.gravity"."""
        ...


class State(Protocol):
    """What a hook reads and writes, each with a leading axis of N simulations; one for a plain `MjData`.

    Attributes:
        gear_torque: what each joint's gear passed on to its link in the last step [N m]: weight, motion and inertia of all that
            hangs on it, without the armature, which sits before the gear.
        constraint: what held or braked each joint in the last step [N m]: dry friction, limits, contacts.
        gain, speed_gain: of each servo's law [N m/rad, N m s/rad].
        limits: the least and the most that each servo gives [N m], infinite where it has no limit.
    """

    time: Float[np.ndarray, "N"]
    qpos: Float[np.ndarray, "N nq"]
    qvel: Float[np.ndarray, "N nv"]
    ctrl: Float[np.ndarray, "N nu"]
    qfrc_bias: Float[np.ndarray, "N nv"]
    actuator_force: Float[np.ndarray, "N outputs"]
    gear_torque: Float[np.ndarray, "N nv"]
    constraint: Float[np.ndarray, "N nv"]
    gain: Float[np.ndarray, "N actuators"]
    speed_gain: Float[np.ndarray, "N actuators"]
    limits: Float[np.ndarray, "N actuators 2"]
    friction: Float[np.ndarray, "N nv"]
    torque: Float[np.ndarray, "N nv"]

    def recent(self, dof: int, seconds: float) -> Float[np.ndarray, "N"]:
        """How fast a joint has been lately [rad/s]: its speed's size, averaged with weights exp(-age / seconds)."""
        ...

    def way(self, dof: int) -> Float[np.ndarray, "N"]:
        """Which way a joint goes, or dry friction holds it from going: 1, -1, or 0 where nothing moves or pulls it."""
        ...

    def let_through(self, index: Mapping[str, int], more: Float[np.ndarray, "N"]) -> Float[np.ndarray, "N"]:
        """What gets through a position servo's limit of `more` torque than its law asks for [N m]."""
        ...


Hook = Callable[[Any, Any, Any], None]


class Effect(ABC):
    """One physical effect. A new one is one new file in `edream/effects/` that defines `ENTRY`.

    Attributes:
        name: the word used in files, configs, commands and reports.
        summary: the words of a sentence, such as "load-dependent friction".
        place: what it acts on. A "pair" acts on its first target because of its second; "world" has no target.
        confusable: effects that some motions cannot tell from this one.
        hook: what MJCF cannot say. Called before each step as `hook(state, index, values)`: adds to `state.friction`
            [N m] or `state.torque` [N m]. `index` is `joint_index` of the first target, and the same with "other_" for a pair's
            second. It is written into the emitted hook file as it stands, so it uses only its arguments and `np`.
        late: 0 where it writes fields of its own; 1 where it changes what others wrote, 2 where it changes what those wrote, and so
            comes after them.
        of_type: whether its numbers belong to a type of hardware, so that joints of one type may share them, rather than to one
            assembly, as a zero offset does.
        shifts_links: whether the links that its joint carries are elsewhere than readings say, which changes their weight on other
            joints as much as on its own: the score test then asks each joint by itself.
        rough: whether its error has many valleys, so that a descent needs a search before it.
        local: whether it acts around one place of the joint's travel, so that its probes lie where the motions went;
            `probes` then gets a model whose joints range as far as those.
        phase: the quantity that is a phase [rad], or None. Its probes then come in pairs, at phase 0 and at a quarter turn.
        of_position_servo: whether it acts on what a servo makes of a commanded position, and so not under torque or speed commands.
        special: a simpler effect that this one is where one of its quantities has a certain value: (effect, quantity, value).
        finer: the same effect with one number more that only some motions tell; its other numbers come first, in the same order.
        reads_past: whether what is read is what was before: a stretch that begins at a reading repeats it, with any model.
        of_creep: whether it shows beside friction that lets stuck joints creep where it does not beside friction that holds.
        creeping: the same effect, with the same numbers, beside friction that lets stuck joints creep; None where it is no other.
        softer: the same effect in other forms with one number more, of which a robot may have one; its other numbers come first.
    """

    name: str
    summary: str
    place: Place
    confusable: tuple[str, ...] = ()
    hook: Hook | None = None
    late: int = 0
    rough: bool = False
    local: bool = False
    phase: str | None = None
    of_type: bool = True
    shifts_links: bool = False
    of_position_servo: bool = False
    special: tuple[str, str, float] | None = None
    reads_past: bool = False
    of_creep: bool = False
    finer: "Effect | None" = None
    creeping: "Effect | None" = None
    softer: "tuple[Effect, ...]" = ()

    @abstractmethod
    def parameters(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[Parameter, ...]:
        """What is unknown, with bounds that suit this robot; names are the quantity alone, such as "torque"."""

    def probes(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[dict[str, float], ...]:
        """Small but visible versions of this effect, each a full set of quantities, for the score test of a diagnosis.

        By default one: each parameter that has an `absent` value moves from it by 5 % of its range, into the box; the others stay
        at their start. An effect whose shape matters gives several (Stribeck speeds, cogging periods, directions of an offset).
        """
        probe = {}
        for p in self.parameters(model, targets):
            step = 0.05 * (p.high - p.low)
            moved = p.start if p.absent is None else p.absent + (step if p.absent + step <= p.high else -step)
            probe[p.name] = moved
        return (probe,)

    def scan(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[dict[str, float], ...]:
        """Probes of an effect with a phase, close enough to each other that one of them is near whatever is true; in pairs, too."""
        return self.probes(model, targets)

    def is_usual(self, values: Mapping[str, float]) -> bool:
        """Whether robots have it so, quantity -> value in its unit: a gear off by a thousandth or a negative payload is met in few.

        Of two answers that motions do not tell apart a usual one is named first, and only such ones explain strange numbers.
        """
        return True

    def on_link(self, model: mujoco.MjModel, values: Mapping[str, float], link: str, other: str) -> dict[str, float] | None:
        """Quantity -> value with which it does from another link what it does from one, with the joints as the model has them.

        None where it acts on no link.
        """
        return None

    def edit(self, spec: mujoco.MjSpec, target: str) -> None:  # noqa: B027 - most effects need no structure
        """Add the structure that `write` fills, once, before compilation, for one target."""

    def write(self, fields: Fields, target: str, values: Values) -> None:  # noqa: B027 - a hook may say it all
        """Write the numbers of one target into the fields of N simulations."""


MOTOR_SUFFIX = "_motor"  # joint of a motor behind a gear that gives or has play
MEASURED_SUFFIX = "_measured"  # sensor of a joint that is read in place of its position


def joint_index(model: mujoco.MjModel, joint: str) -> dict[str, int]:
    """Addresses of a joint and of the actuator that drives it.

    Returns:
        "joint", "dof" and "qpos" of the joint itself; "actuator", "ctrl" and "force" (into `actuator_force`) of its servo; "drive"
        and "drive_qpos", the motor's own degree of freedom: the joint's, unless a gear with play or give lies between
        (`<joint>_motor`).

    Raises:
        EdreamError: no actuator drives the joint.
    """
    number = model.joint(joint).id
    drives = {number, *(j for j in range(model.njnt) if model.joint(j).name == joint + MOTOR_SUFFIX)}
    for actuator in range(model.nactuator):
        driven = int(model.actuator_trnid[actuator, 0])
        if int(model.actuator_trntype[actuator]) in (0, 1) and driven in drives and model.actuator_ctrlnum[actuator]:
            return {
                "joint": number,
                "dof": int(model.jnt_dofadr[number]),
                "qpos": int(model.jnt_qposadr[number]),
                "actuator": actuator,
                "ctrl": int(model.actuator_ctrladr[actuator]),
                "force": int(model.actuator_outadr[actuator]),
                "drive": int(model.jnt_dofadr[driven]),
                "drive_qpos": int(model.jnt_qposadr[driven]),
            }
    raise EdreamError(f"Joint {joint!r} has no actuator of its own; effects act on actuated joints.")


def holds_position(model: mujoco.MjModel, joint: str) -> bool:
    """Whether a joint's servo pulls it to a position, rather than giving a torque or following a speed.

    Raises:
        EdreamError: no actuator drives the joint.
    """
    return bool(model.actuator_biasprm[joint_index(model, joint)["actuator"], 1] < 0.0)
