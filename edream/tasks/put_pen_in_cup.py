"""Put the pen into the cup."""

from collections.abc import Mapping

import numpy as np

from edream.core.bench import Arm
from edream.core.policy import Outcome
from edream.core.scene import SceneObject
from edream.core.task import Part, Scene, Task, Thing, Waypoint, facing, rotation
from edream.core.things import cup

LYING = np.array([np.sqrt(0.5), 0.0, np.sqrt(0.5), 0.0])  # the pen's axis, its z, along the table's x
TILT, LEVEL = 0.08, 1.42  # how the hand leans over the lying pen, and over the cup, where the pen then hangs nearly upright
SINK = np.array([0.0, 0.0, 0.008])  # how far above the pen's axis the fingertips' middle is [m]


class PutPenInCup(Task):
    """A pen lies and a cup stands before the arm. Done when one end of the pen is in the lower half of the standing cup, let go."""

    name = "put_pen_in_cup"
    sentence = "Put the pen into the cup."
    seconds = 10.0

    def things(self, rng: np.random.Generator) -> tuple[Thing, ...]:
        one, two = rng.permutation([-1.0, 1.0]) * rng.uniform(0.18, 0.36, 2)
        far, there = rng.uniform(0.27, 0.34), rng.uniform(0.33, 0.37)
        place, goal = far * np.array([np.cos(one), np.sin(one)]), there * np.array([np.cos(two), np.sin(two)])
        half, radius = rng.uniform(0.055, 0.065), rng.uniform(0.006, 0.0075)
        angle = one + rng.uniform(-0.25, 0.25)
        turn = _times(np.array([np.cos(angle / 2), 0.0, 0.0, np.sin(angle / 2)]), LYING)
        pose = np.concatenate([place, [radius], turn])
        colour = (0.85, 0.2, 0.15)
        # hexagonal, so that it does not roll away: three flat boxes about the axis
        width = radius * np.tan(np.pi / 6)
        parts = tuple(
            Part("box", (radius, width, half), quat=(float(np.cos(a / 2)), 0.0, 0.0, float(np.sin(a / 2))))
            for a in np.pi / 3 * np.arange(3)
        )
        pen = Thing("pen", parts, SceneObject("pen", "cylinder", (radius, half), colour), rng.uniform(0.015, 0.03), 0.4, pose)
        holder = cup("cup", goal, 0.04, 0.085, 0.25, 0.6, (0.3, 0.55, 0.4))
        return pen, holder

    def plan(self, things: Mapping[str, Thing], arm: Arm, rng: np.random.Generator) -> list[Waypoint]:
        pen, goal = things["pen"], things["cup"].pose[:3]
        middle, (radius, half) = pen.pose[:3], pen.proxy.size
        along = rotation(pen.pose[3:])[:, 2]
        azimuth, over_there = float(np.arctan2(along[1], along[0])), float(np.arctan2(goal[1], goal[0]))
        turn, level = facing(azimuth, TILT + rng.normal(0.0, 0.02)), facing(over_there, LEVEL)
        grip = middle + 0.25 * half * along + SINK
        inset, wide = arm.fixed - radius, 2 * radius + 0.03
        open_at, closed = grip - turn[:, 1] * (inset - 0.012), grip - turn[:, 1] * inset
        # the pen keeps its place in the hand
        axis = level @ (turn.T @ along)
        low = goal[2] + things["cup"].proxy.size[1]
        hang = (
            np.array([goal[0], goal[1], low]) + (1.25 * half * np.sign(axis[2]) * axis) - level @ (turn.T @ (grip - SINK - closed))
        )
        pace = rng.uniform(0.9, 1.1)
        return [
            Waypoint(open_at - 0.09 * turn[:, 0], turn, wide, 1.2 * pace),
            Waypoint(open_at, turn, wide, 0.8 * pace, exact=True),
            Waypoint(closed, turn, 0.0, 0.5 * pace),
            Waypoint(closed, turn, 0.0, 0.2),
            Waypoint(closed + [0.0, 0.0, 0.09], turn, 0.0, 0.8 * pace),
            Waypoint(hang + [0.0, 0.0, 0.05], level, 0.0, 1.6 * pace, exact=True),
            Waypoint(hang - [0.0, 0.0, 0.025], level, 0.0, 0.8 * pace, exact=True),
            Waypoint(hang - [0.0, 0.0, 0.025], level, wide, 0.4),
            Waypoint(hang - 0.08 * level[:, 0], level, wide, 0.7 * pace),
        ]

    def outcome(self, scene: Scene) -> Outcome:
        pose, goal = scene.poses["pen"], scene.poses["cup"]
        half = scene.layout.thing("pen").proxy.size[1]
        radius, high = scene.layout.thing("cup").proxy.size
        ends = [rotation(goal[3:]).T @ (pose[:3] + side * half * rotation(pose[3:])[:, 2] - goal[:3]) for side in (-1.0, 1.0)]
        inside = min(ends, key=lambda end: end[2])
        upright = rotation(goal[3:])[2, 2] > 0.9
        stands = inside[2] < 0.5 * high and float(np.hypot(*inside[:2])) < radius
        distance, held = float(np.linalg.norm(pose[:3] - goal[:3])), "pen" in scene.pinched
        if "pen" not in scene.lifted:
            distance += float(np.linalg.norm(scene.hand - pose[:3]))
        return Outcome(bool(stands and upright and not held), "pen" in scene.lifted, distance)


def _times(one: np.ndarray, two: np.ndarray) -> np.ndarray:
    (a, b, c, d), (e, f, g, h) = one, two
    return np.array(
        [
            a * e - b * f - c * g - d * h,
            a * f + b * e + c * h - d * g,
            a * g - b * h + c * e + d * f,
            a * h + b * g - c * f + d * e,
        ]
    )


ENTRY = PutPenInCup()
