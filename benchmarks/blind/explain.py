"""Phase 2, a process of its own: recordings and a nominal model in, a diagnosis out. Sees nothing else.

python -m benchmarks.blind.explain ROBOT.xml DATA OUT.json [--baselines] [--suggest MOTION.csv] [--beside MORE_DATA]
"""

import argparse
import json
import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from benchmarks.blind.guard import blindfold


def main() -> None:
    """Diagnose one data set blindfolded and write the result."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("robot", type=Path)
    parser.add_argument("data", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--baselines", action="store_true")
    parser.add_argument("--suggest", type=Path, help="where the motion to record next is written, if there is one")
    parser.add_argument(
        "--beside", type=Path, nargs="*", default=[], help="recordings of that motion, diagnosed together with the others"
    )
    given = parser.parse_args()
    blindfold()
    diagnosis, result = explain(given.robot, given.data, given.beside)
    if given.suggest and (motion := suggestion(diagnosis)):
        given.suggest.write_text(motion.table(), encoding="utf-8")
        given.suggest.with_suffix(".json").write_text(json.dumps([dict(one) for one in motion.conditions]), encoding="utf-8")
    given.out.write_text(json.dumps(_finite(result)) + "\n", encoding="utf-8")
    if given.baselines:
        from benchmarks.blind.baselines import run_baselines

        result["baselines"] = run_baselines(diagnosis)
        given.out.write_text(json.dumps(_finite(result)) + "\n", encoding="utf-8")


def explain(robot_path: Path, data: Path, beside: Sequence[Path] = ()) -> tuple[Any, dict[str, Any]]:
    """Ingest the recordings and diagnose them, as `edream diagnose robot.mjcf=R.xml data=D` does: the `Diagnosis`, its summary.

    `beside` are further recordings of the same robot.
    """
    from edream.core.episode import Episode
    from edream.diagnosis.problem import Settings, prepare
    from edream.diagnosis.verdict import diagnose
    from edream.ingest.recordings import ingest_recordings
    from edream.sim.robot import load_robot

    began = time.monotonic()
    robot = load_robot(robot_path)
    episodes: list[Episode] = []
    for folder in (data, *beside):
        found = [one[0] for one in ingest_recordings(folder, robot.joints, strict=True) if isinstance(one, tuple)]
        episodes += [replace(episode, name=f"{folder.name}/{episode.name}") for episode in found]
    problem = prepare(robot, episodes, Settings())
    diagnosis = diagnose(problem)
    return diagnosis, summary(diagnosis) | {"seconds": time.monotonic() - began}


def suggestion(found: Any) -> Any:
    """The motion that a diagnosis in doubt would have recorded next; None where it is not in doubt or knows of none."""
    import numpy as np

    from edream.diagnosis.next_motion import suggest

    if len(found.contenders) < 2:
        return None
    return suggest(found.problem, [fit for _, fit in found.contenders], np.random.default_rng(found.problem.settings.seed))


def summary(found: Any) -> dict[str, Any]:
    """What is scored of a `Diagnosis`."""
    return {
        "verdict": found.verdict,
        "sentence": found.sentence,
        "effects": [
            {
                "name": one.name,
                "targets": list(one.targets),
                "values": dict(one.values),
                "intervals": {name: list(pair) for name, pair in one.intervals.items()},
                "closed": one.closed,
                "runner_up": one.runner_up,
                "confusable_with": list(one.confusable_with),
            }
            for one in found.effects
        ],
        "gap": {
            "published_rad": found.published_rms,
            "before_rad": found.before_rms,
            "after_rad": found.after_rms,
            "noise_floor_rad": found.problem.noise_floor,
            "floor_rad": found.problem.floor,
        },
        "rounds": [
            [[t.candidate.label, t.closed] for t in sorted(one.trials, key=lambda t: -t.closed)[:5]] for one in found.rounds
        ],
        "formula": None if found.remainder is None else found.remainder.formula,
        "remainder_joint": None if found.remainder is None else found.remainder.joint,
    }


def _finite(value: Any) -> Any:
    """The same value with what JSON cannot say as null."""
    if isinstance(value, Mapping):
        return {key: _finite(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(one) for one in value]
    if hasattr(value, "item"):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value


if __name__ == "__main__":
    main()
