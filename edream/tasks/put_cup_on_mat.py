"""Put the cup on the mat."""

from collections.abc import Mapping

import numpy as np

from edream.core.bench import Arm
from edream.core.policy import Outcome
from edream.core.task import Scene, Task, Thing, Waypoint, facing, rotation
from edream.core.things import cup, mat

TILT = 0.55
NEAR = 0.03  # how far the cup's middle may be from the mat's [m]


class PutCupOnMat(Task):
    """A cup stands beside a round mat. Done when it stands upright on the mat, within 3 cm of its middle, let go."""

    name = "put_cup_on_mat"
    sentence = "Put the cup on the mat."
    seconds = 9.0

    def things(self, rng: np.random.Generator) -> tuple[Thing, ...]:
        one, two = rng.permutation([-1.0, 1.0]) * rng.uniform(0.16, 0.38, 2)
        far = rng.uniform(0.25, 0.36, 2)
        radius, height = rng.uniform(0.024, 0.0275), rng.uniform(0.08, 0.095)
        place, goal = far[0] * np.array([np.cos(one), np.sin(one)]), far[1] * np.array([np.cos(two), np.sin(two)])
        standing = cup("cup", place, radius, height, rng.uniform(0.05, 0.12), rng.uniform(0.35, 0.55), (0.25, 0.45, 0.8))
        return standing, mat("mat", goal, 0.05, (0.75, 0.25, 0.3))

    def plan(self, things: Mapping[str, Thing], arm: Arm, rng: np.random.Generator) -> list[Waypoint]:
        thing, goal = things["cup"], things["mat"].pose[:3]
        middle, (radius, half) = thing.pose[:3], thing.proxy.size
        tilt, high = TILT + rng.normal(0.0, 0.03), half - 0.028 + rng.normal(0.0, 0.002)
        turn, there = (facing(float(np.arctan2(at[1], at[0])), tilt) for at in (middle, goal))
        grip = middle + [0.0, 0.0, high]
        inset, held = arm.fixed - radius, 2 * radius - 0.022
        closed = grip - turn[:, 1] * inset  # the fixed finger touches, so that the cup stays where it is
        landed = goal + [0.0, 0.0, half + high + 0.003]
        pressed = landed - there[:, 1] * inset
        up, over = [0.0, 0.0, 0.06], [0.0, 0.0, 0.05]
        pace = rng.uniform(0.9, 1.1)
        return [
            Waypoint(grip - 0.085 * turn[:, 0], turn, arm.most, 1.1 * pace),
            Waypoint(grip, turn, arm.most, 0.7 * pace, exact=True),
            Waypoint(closed, turn, held, 0.5 * pace),
            Waypoint(closed, turn, held, 0.2),
            Waypoint(closed + up, turn, held, 0.6 * pace),
            Waypoint(pressed + over, there, held, 1.3 * pace, exact=True),
            Waypoint(pressed, there, held, 0.6 * pace, exact=True),
            Waypoint(landed, there, arm.most, 0.5 * pace),
            Waypoint(landed - 0.1 * there[:, 0], there, arm.most, 0.7 * pace),
        ]

    def outcome(self, scene: Scene) -> Outcome:
        pose, goal, half = scene.poses["cup"], scene.layout.thing("mat").pose[:3], scene.layout.thing("cup").proxy.size[1]
        target = goal + [0.0, 0.0, half + 0.0015]
        distance, held = float(np.linalg.norm(pose[:3] - target)), "cup" in scene.pinched
        upright = rotation(pose[3:])[2, 2] > 0.95
        stands = abs(pose[2] - target[2]) < 0.006 and np.linalg.norm(pose[:2] - target[:2]) < NEAR
        if "cup" not in scene.lifted:
            distance += float(np.linalg.norm(scene.hand - pose[:3]))
        return Outcome(bool(stands and upright and not held), "cup" in scene.lifted, distance)


ENTRY = PutCupOnMat()
