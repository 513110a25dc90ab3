"""A task: which things lie on the table, how an expert would do it, and when it is done. Any world can play it."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float, Int

from edream.core.bench import Arm
from edream.core.policy import Outcome
from edream.core.scene import SceneObject

UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])
LIFTED = 0.02  # a thing this far above where it lay, between the fingers, was grasped [m]


@dataclass(frozen=True, eq=False)
class Part:
    """A primitive shape of a thing.

    Attributes:
        shape: box, cylinder, capsule or sphere.
        size: half sizes, or radius and half length [m].
        pos, quat: in the thing's frame [m], w x y z.
    """

    shape: str
    size: tuple[float, ...]
    pos: tuple[float, float, float] = (0.0, 0.0, 0.0)
    quat: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, eq=False)
class Thing:
    """Something on the table.

    Attributes:
        name: what it is called.
        parts: what it is made of; all of it touches and is touched.
        proxy: one plain shape about the same origin, for who models it roughly, with its colour.
        mass: of the whole [kg].
        friction: sliding friction against the table and other things.
        pose: where it begins, x y z [m] and quaternion w x y z, in the robot's base frame.
        fixed: whether it is glued to the table (a mat).
    """

    name: str
    parts: tuple[Part, ...]
    proxy: SceneObject
    mass: float
    friction: float
    pose: Float[np.ndarray, "7"]
    fixed: bool = False

    def moved(self, offset: Sequence[float] | np.ndarray) -> "Thing":
        """The same thing elsewhere."""
        return replace(self, pose=self.pose + np.concatenate([offset, np.zeros(4)]))


@dataclass(frozen=True, eq=False)
class Layout:
    """What a start means.

    Attributes:
        things: everything on the table.
        arm: which arm is to work.
        grip: sliding friction of the fingertips against things.
    """

    things: tuple[Thing, ...]
    arm: int
    grip: float

    def thing(self, name: str) -> Thing:
        """The thing of this name."""
        return next(one for one in self.things if one.name == name)


@dataclass(frozen=True, eq=False)
class Waypoint:
    """Where a hand is to be, and when.

    Attributes:
        pos: of the end-effector site [m], in the robot's base frame.
        turn: its axes as columns, (3, 3).
        gap: between the fingers [m].
        seconds: time to get there from the waypoint before.
        exact: whether to wait there until the hand has arrived.
    """

    pos: Float[np.ndarray, "3"]
    turn: Float[np.ndarray, "3 3"]
    gap: float
    seconds: float
    exact: bool = False


@dataclass(eq=False)
class Scene:
    """How things stand at one moment of a trial, and what was seen of it before.

    Attributes:
        layout: how it began.
        poses: of every thing, (7,).
        hand: position of the working arm's site [m].
        pinched: names of things that both fingers of an arm touch.
        lifted: names of things that were in the air between two fingers at some moment.
    """

    layout: Layout
    poses: Mapping[str, Float[np.ndarray, "7"]]
    hand: Float[np.ndarray, "3"]
    pinched: frozenset[str] = frozenset()
    lifted: set[str] = field(default_factory=set)

    def see(self, poses: Mapping[str, np.ndarray], hand: np.ndarray, pinched: frozenset[str]) -> None:
        """Go on to the next moment."""
        self.poses, self.hand, self.pinched = poses, hand, pinched
        for name in pinched:
            if poses[name][2] - self.layout.thing(name).pose[2] > LIFTED:
                self.lifted.add(name)


class Task(ABC):
    """An entry of the catalog `edream/tasks/`.

    Attributes:
        name: its name.
        sentence: what is to be done, as one would tell a person.
        seconds: how long a trial lasts [s].
    """

    name: str
    sentence: str
    seconds: float

    @abstractmethod
    def things(self, rng: np.random.Generator) -> tuple[Thing, ...]:
        """What lies on the table, about an arm whose foot stands at the origin of a table at height 0, x pointing ahead."""

    @abstractmethod
    def plan(self, things: Mapping[str, Thing], arm: Arm, rng: np.random.Generator) -> list[Waypoint]:
        """How an expert does it, in the same frame as `things`, from a look at where everything lies."""

    @abstractmethod
    def outcome(self, scene: Scene) -> Outcome:
        """Whether it is done."""

    def layout(self, start: int, arms: Sequence[Arm]) -> Layout:
        """What a start means for a robot with these arms; the same whatever world it is played in."""
        rng = np.random.default_rng(np.random.SeedSequence((start, 0x57A7)))
        arm, grip = int(rng.integers(len(arms))), float(rng.uniform(0.8, 1.1))
        return Layout(tuple(one.moved(arms[arm].base) for one in self.things(rng)), arm, grip)

    def waypoints(self, layout: Layout, arms: Sequence[Arm], rng: np.random.Generator) -> list[Waypoint]:
        """The expert's plan in the robot's base frame."""
        base = np.array(arms[layout.arm].base)
        things = {one.name: one.moved(-base) for one in layout.things}
        return [replace(one, pos=one.pos + base) for one in self.plan(things, arms[layout.arm], rng)]


def facing(azimuth: float, tilt: float, twist: float = 0.0) -> Float[np.ndarray, "3 3"]:
    """Axes of a hand that points down, leaning outwards.

    Args:
        azimuth: direction it leans to [rad].
        tilt: angle between where it points and straight down [rad].
        twist: turn about where it points [rad].
    """
    out, side = np.array([np.cos(azimuth), np.sin(azimuth), 0.0]), np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    ahead = np.sin(tilt) * out - np.array([0.0, 0.0, np.cos(tilt)])
    up = np.cross(ahead, side)
    y = np.cos(twist) * side + np.sin(twist) * up
    return np.stack([ahead, y, np.cross(ahead, y)], axis=1)


def about_z(angle: float) -> Float[np.ndarray, "4"]:
    """Quaternion of a turn about the vertical [rad]."""
    return np.array([np.cos(angle / 2), 0.0, 0.0, np.sin(angle / 2)])


def rotation(quat: Float[np.ndarray, "4"]) -> Float[np.ndarray, "3 3"]:
    """Rotation matrix of a quaternion w x y z."""
    w, x, y, z = quat / np.linalg.norm(quat)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def pinched(pairs: Int[np.ndarray, "C 2"], finger: Int[np.ndarray, "G"], thing: Sequence[str | None]) -> frozenset[str]:
    """Names of the things that both fingers of an arm touch.

    Args:
        pairs: the two geoms of every contact.
        finger: 2 x arm for each geom of its fixed finger, 2 x arm + 1 for its moving one, -1 for any other geom.
        thing: of each geom, the thing it is part of.
    """
    met: dict[str, set[int]] = {}
    sides = finger[pairs]
    for number, side in zip(*np.nonzero(sides >= 0), strict=True):  # most contacts are no finger's
        name = thing[int(pairs[number, 1 - side])]
        if name is not None:
            met.setdefault(name, set()).add(int(sides[number, side]))
    return frozenset(name for name, fingers in met.items() if any(f % 2 == 0 and f + 1 in fingers for f in fingers))
