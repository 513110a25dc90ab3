"""Where a robot stands when it works: its table, its hands, its cameras. The same for the simulator and for reality."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from edream.core.camera import looking_at
from edream.core.errors import EdreamError


@dataclass(frozen=True, eq=False)
class Arm:
    """One arm with a two-finger gripper, of which one finger moves.

    Attributes:
        site: end-effector site, between the fingertips: x points out of the hand, y from the moving to the fixed finger.
        joints: its joints, without the gripper.
        gripper: its gripper, a slide whose position is the gap between the fingers [m].
        base: where its foot stands in the robot's base frame [m], on the table's level.
        home: resting position of `joints` [rad].
        fixed: y of the fixed finger's inner face in the site's frame [m].
        most: widest gap [m].
    """

    site: str
    joints: tuple[str, ...]
    gripper: str
    base: tuple[float, float, float]
    home: tuple[float, ...]
    fixed: float = 0.035
    most: float = 0.07


@dataclass(frozen=True, eq=False)
class View:
    """A camera of the workcell.

    Attributes:
        pose: of the camera (x right, y down, z forward) in the robot's base frame, or in the frame of the site `on`.
        fovy: vertical field of view [rad].
        on: site that carries it, or None where it stands still.
    """

    pose: Float[np.ndarray, "4 4"]
    fovy: float
    on: str | None = None


@dataclass(frozen=True, eq=False)
class Bench:
    """A robot's workplace.

    Attributes:
        arms: its arms; tasks are drawn for one of them at a time.
        table: half sizes and centre of the table top, a box [m].
        views: cameras by name.
    """

    arms: tuple[Arm, ...]
    table: tuple[tuple[float, float, float], tuple[float, float, float]]
    views: Mapping[str, View] = field(default_factory=dict)

    def view(self, name: str) -> View:
        """A camera of this workcell.

        Raises:
            EdreamError: it has no such camera.
        """
        if name not in self.views:
            raise EdreamError(f"This workcell has no camera {name!r}. What exists: {', '.join(self.views)}.")
        return self.views[name]


HOME = (0.0, 0.95, 0.85, 0.0, 0.6, 0.0)
HAND_VIEW = View(looking_at(np.array([-0.03, 0.0, 0.085]), np.array([0.12, 0.0, 0.0])), 1.2)


def _arm(prefix: str, base: tuple[float, float, float]) -> Arm:
    joints = tuple(f"{prefix}joint{number}" for number in range(1, 7))
    return Arm(f"{prefix}ee", joints, f"{prefix}gripper", base, HOME)


def _views(base: tuple[float, float, float], arms: tuple[Arm, ...], width: float) -> dict[str, View]:
    at = np.array(base)
    high = looking_at(at + [0.72 + width, 0.0, 0.62 + 0.6 * width], at + [0.28, 0.0, 0.06])
    side = looking_at(at + [0.34, -0.72 - width, 0.34], at + [0.26, 0.0, 0.08])
    views = {"cam_high": View(high, 0.58 + 1.1 * width), "cam_side": View(side, 0.62)}
    for arm in arms:
        views[arm.site.removesuffix("ee") + "wrist"] = View(HAND_VIEW.pose, HAND_VIEW.fovy, arm.site)
    return views


def _benches() -> dict[str, Bench]:
    one = (_arm("", (0.0, 0.0, 0.0)),)
    two = (_arm("left_", (0.0, 0.3, 0.6)), _arm("right_", (0.0, -0.3, 0.6)))
    return {
        "arm6": Bench(one, ((0.40, 0.45, 0.02), (0.30, 0.0, -0.02)), _views((0.0, 0.0, 0.0), one, 0.0)),
        "cobot": Bench(two, ((0.26, 0.65, 0.02), (0.34, 0.0, 0.58)), _views((0.0, 0.0, 0.6), two, 0.3)),
    }


BENCHES: Mapping[str, Bench] = _benches()


def bench_of(robot: str) -> Bench:
    """The workplace of a robot.

    Raises:
        EdreamError: there is none for this robot.
    """
    if robot not in BENCHES:
        raise EdreamError(f"Robot {robot!r} has no workcell, so it has no tasks. What exists: {', '.join(BENCHES)}.")
    return BENCHES[robot]
