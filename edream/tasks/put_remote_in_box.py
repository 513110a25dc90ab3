"""Put the remote control into the box."""

from collections.abc import Mapping

import numpy as np

from edream.core.bench import Arm
from edream.core.policy import Outcome
from edream.core.task import Scene, Task, Thing, Waypoint, facing, rotation
from edream.core.things import bar, tray

TILT = 0.45


class PutRemoteInBox(Task):
    """A remote control lies beside an open box. Done when its middle is inside the box, let go."""

    name = "put_remote_in_box"
    sentence = "Put the remote control into the box."
    seconds = 9.0

    def things(self, rng: np.random.Generator) -> tuple[Thing, ...]:
        one, two = rng.permutation([-1.0, 1.0]) * rng.uniform(0.2, 0.4, 2)
        far = rng.uniform(0.26, 0.34, 2)
        place, goal = far[0] * np.array([np.cos(one), np.sin(one)]), far[1] * np.array([np.cos(two), np.sin(two)])
        size = (rng.uniform(0.055, 0.07), rng.uniform(0.016, 0.021), rng.uniform(0.010, 0.013))
        remote = bar(
            "remote",
            place,
            size,
            one + rng.uniform(-0.35, 0.35),
            rng.uniform(0.06, 0.12),
            rng.uniform(0.35, 0.55),
            (0.12, 0.12, 0.14),
        )
        box = tray("box", goal, (0.095, 0.065, 0.022), two, 0.4, 0.6, (0.8, 0.7, 0.45))
        return remote, box

    def plan(self, things: Mapping[str, Thing], arm: Arm, rng: np.random.Generator) -> list[Waypoint]:
        remote, box = things["remote"], things["box"]
        middle, goal, width = remote.pose[:3], box.pose[:3], remote.proxy.size[1]
        along = rotation(remote.pose[3:])[:, 0]
        azimuth, over_there = float(np.arctan2(along[1], along[0])), float(np.arctan2(goal[1], goal[0]))
        tilt = TILT + rng.normal(0.0, 0.03)
        turn, there = facing(azimuth, tilt), facing(over_there, tilt)
        grip = middle + [0.0, 0.0, 0.008]
        inset, held, wide = arm.fixed - width, 2 * width - 0.02, min(arm.most, 2 * width + 0.026)
        open_at = grip - turn[:, 1] * (inset - 0.012)
        closed = grip - turn[:, 1] * inset  # the fixed finger touches, so that the remote stays where it is
        drop = goal + [0.0, 0.0, 0.034] - there[:, 1] * inset
        pace = rng.uniform(0.9, 1.1)
        return [
            Waypoint(open_at - 0.09 * turn[:, 0], turn, wide, 1.2 * pace),
            Waypoint(open_at, turn, wide, 0.8 * pace, exact=True),
            Waypoint(closed, turn, max(held, 0.0), 0.5 * pace),
            Waypoint(closed, turn, max(held, 0.0), 0.2),
            Waypoint(closed + [0.0, 0.0, 0.1], turn, max(held, 0.0), 0.7 * pace),
            Waypoint(drop + [0.0, 0.0, 0.07], there, max(held, 0.0), 1.3 * pace, exact=True),
            Waypoint(drop, there, max(held, 0.0), 0.5 * pace),
            Waypoint(drop, there, wide, 0.4 * pace),
            Waypoint(drop - 0.1 * there[:, 0], there, wide, 0.7 * pace),
        ]

    def outcome(self, scene: Scene) -> Outcome:
        pose, box = scene.poses["remote"], scene.poses["box"]
        place = rotation(box[3:]).T @ (pose[:3] - box[:3])
        x, y, z = scene.layout.thing("box").proxy.size
        inside = abs(place[0]) < x and abs(place[1]) < y and place[2] < z
        distance, held = float(np.linalg.norm(place)), "remote" in scene.pinched
        if "remote" not in scene.lifted:
            distance += float(np.linalg.norm(scene.hand - pose[:3]))
        return Outcome(bool(inside and not held), "remote" in scene.lifted, distance)


ENTRY = PutRemoteInBox()
