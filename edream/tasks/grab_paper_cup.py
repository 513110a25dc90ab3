"""Grab the paper cup and lift it off the table."""

from collections.abc import Mapping

import numpy as np

from edream.core.bench import Arm
from edream.core.policy import Outcome
from edream.core.task import Scene, Task, Thing, Waypoint, facing, rotation
from edream.core.things import cup

HIGHER = 0.12  # where the cup is to be, above where it stood [m]
ENOUGH = 0.05  # how far above the table it counts as lifted [m]
TILT = 0.55


class GrabPaperCup(Task):
    """A paper cup stands before the arm. Done when, at the end, it is between both fingers, upright, 5 cm or more up."""

    name = "grab_paper_cup"
    sentence = "Grab the paper cup and lift it."
    seconds = 6.0

    def things(self, rng: np.random.Generator) -> tuple[Thing, ...]:
        far, side = rng.uniform(0.24, 0.37), rng.uniform(-0.45, 0.45)
        radius, height = rng.uniform(0.024, 0.0275), rng.uniform(0.085, 0.1)
        place = (far * np.cos(side), far * np.sin(side))
        return (cup("cup", place, radius, height, rng.uniform(0.03, 0.06), rng.uniform(0.3, 0.5), (0.93, 0.93, 0.9)),)

    def plan(self, things: Mapping[str, Thing], arm: Arm, rng: np.random.Generator) -> list[Waypoint]:
        thing = things["cup"]
        middle, radius = thing.pose[:3], thing.proxy.size[0]
        azimuth = float(np.arctan2(middle[1], middle[0]))
        turn = facing(azimuth, TILT + rng.normal(0.0, 0.03))
        grip = middle + [0.0, 0.0, thing.proxy.size[1] - 0.028 + rng.normal(0.0, 0.002)]
        closed = grip - turn[:, 1] * (arm.fixed - radius)  # the fixed finger touches, so that the cup stays where it is
        above = grip - 0.085 * turn[:, 0]
        up = closed + [0.0, 0.0, HIGHER]
        pace = rng.uniform(0.9, 1.1)
        return [
            Waypoint(above, turn, arm.most, 1.3 * pace),
            Waypoint(grip, turn, arm.most, 0.8 * pace, exact=True),
            Waypoint(closed, turn, 2 * radius - 0.022, 0.5 * pace),
            Waypoint(closed, turn, 2 * radius - 0.022, 0.25),
            Waypoint(up, turn, 2 * radius - 0.022, 1.0 * pace),
            Waypoint(up, turn, 2 * radius - 0.022, 0.4),
        ]

    def outcome(self, scene: Scene) -> Outcome:
        pose, began = scene.poses["cup"], scene.layout.thing("cup").pose
        upright = rotation(pose[3:])[2, 2] > 0.7
        held = "cup" in scene.pinched
        target = began[:3] + [0.0, 0.0, HIGHER]
        distance = float(np.linalg.norm(pose[:3] - target))
        if not held:
            distance += float(np.linalg.norm(scene.hand - pose[:3]))
        return Outcome(bool(held and upright and pose[2] - began[2] > ENOUGH), "cup" in scene.lifted, distance)


ENTRY = GrabPaperCup()
