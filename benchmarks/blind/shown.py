"""What a hidden effect does to the recorded motion at all: the same robot, without noise, with its effects and without them."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.blind.cases import Case, Session
from edream.reality.recorder import Recorder, make_recordings
from edream.reality.truth import Truth
from edream.record import motion_seed
from edream.sim.robot import RobotModel

EXACT = Recorder(jitter=0.0, noise=0.0, counts=2**30)


def shown(case: Case, truth: Truth, robot: RobotModel, session: Session, folder: Path) -> float:
    """Root mean square over joints and time of what the hidden effects change in a case [rad]; kept beside its truth.

    An effect that changes less than the encoder's noise, such as a torque limit that no motion reaches, nobody can name.
    """
    kept = folder / "truth" / f"{case.code}.shown.json"
    if not kept.exists():
        chance = motion_seed(case.seed)
        moved = [
            np.concatenate([one.position for one in make_recordings(robot, some, chance, session.motions, session.seconds, EXACT)])
            for some in (truth, replace(truth, effects=()))
        ]
        kept.write_text(json.dumps(float(np.sqrt(np.mean((moved[0] - moved[1]) ** 2)))) + "\n", encoding="utf-8")
    return float(json.loads(kept.read_text(encoding="utf-8")))
