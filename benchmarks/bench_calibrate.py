"""Calibration against its peers: surrogate, Gauss-Newton, annealing (400 steps), CMA-ES and mujoco.sysid on the same loss and data.

    python benchmarks/bench_calibrate.py [--case arm6 --case so101] [--seconds 400] [--out DIR]

Every method starts at the published numbers, searches the same box, and sees the same stretches of the same training motions.
The error is that of replaying whole motions that none of them saw. The surrogate counts its sweep and its learning. CPU seconds
stand beside wall-clock seconds because other programs may share the machine. Simulated seconds count motion, all runs added.
`edream calibrate` takes last steps joint by joint after whatever search and works out intervals there; "finished" is the default
search with these.
`mujoco.sysid` needs the `bench` extra; it runs with its own optimiser, rollouts and residual (joint position), on our unit box.

The real SO-101 recordings are taken from EDREAM_SHARED_DATA or a folder `shared/data` beside the repository; absent, that case is
left out.
"""

import argparse
import json
import os
import tempfile
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import numpy as np

from edream import catalog, config
from edream.calibration.data import sampling_stride, stretches
from edream.calibration.problem import Fitter, FitterOptions, Problem
from edream.calibration.settings import RobotSettings, SpaceSettings, scored, simulated_robot
from edream.calibration.split import split_motions
from edream.calibration.surrogate import Surrogate
from edream.calibration.sweeping import from_tables
from edream.core.episode import Episode
from edream.core.stage import Work
from edream.ingest.mapping import MappingConfig
from edream.ingest.recordings import ingest_recordings
from edream.record import RecordConfig, record
from edream.sim.objective import Objective, rms
from edream.sim.polish import finish
from edream.sim.window import whole
from edream.stages.fit import with_surrogate
from edream.stages.sweep import SweepSettings, sweep, windows_of

FINISHED = "gauss_newton, finished"
METHODS = ("gauss_newton", FINISHED, "surrogate", "annealing", "cmaes", "mujoco.sysid")
EFFECTS = ("servo_gain", "viscous", "coulomb", "armature")
UNTIL = 40.0


@dataclass(frozen=True, eq=False)
class Case:
    """One robot with its recordings, split."""

    name: str
    problem: Problem
    train: list[Episode]
    judge: Objective


class Memory:
    """A stage's work, kept in memory: what `edream.core.stage.Work` offers and a sweep uses."""

    def seed(self, name: str) -> int:
        return sum(name.encode())

    def shards(self, name: str, items: Iterable[Any], function: Callable[..., Any], parallel: object = True) -> list[Any]:
        return [function(item, np.random.default_rng(0)) for item in items]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--case", action="append", choices=("arm6", "so101"))
    parser.add_argument("--method", action="append", choices=METHODS)
    parser.add_argument("--seconds", type=float, default=400.0, help="motion that every method replays for one value of the loss")
    parser.add_argument("--out", type=Path, default=Path("runs") / "bench")
    options = parser.parse_args()
    tables = []
    for name in options.case or ("arm6", "so101"):
        case = {"arm6": arm6, "so101": so101}[name](options.seconds)
        if case is None:
            print("so101: no recordings; set EDREAM_SHARED_DATA")
            continue
        tables.append(measured(case, options.method or METHODS))
        options.out.mkdir(parents=True, exist_ok=True)
        (options.out / "calibrate.json").write_text(json.dumps(tables, indent=1) + "\n")
        (options.out / "calibrate.md").write_text("\n\n".join(markdown(table) for table in tables) + "\n")
        print(markdown(tables[-1]), flush=True)


def measured(case: Case, methods: Sequence[str]) -> dict[str, Any]:
    """Every method on one case."""
    space = case.problem.space
    rows = []
    for method in methods:
        problem = replace(case.problem, objective=replace(case.problem.objective, simulations=0))
        clock, cpu = time.perf_counter(), time.process_time()
        try:
            values, simulated = solve(method, problem, case)
        except ImportError as error:
            print(f"{method}: left out, {error}")
            continue
        row = {
            "method": method,
            "seconds": time.perf_counter() - clock,
            "cpu_seconds": time.process_time() - cpu,
            "simulated_s": simulated,
        }
        row["train_rad"] = rms(problem.objective.residuals(values)[0])
        row["heldout_rad"] = rms(case.judge.residuals(values)[0])
        rows.append(row)
        print({k: round(v, 4) if isinstance(v, float) else v for k, v in row.items()}, flush=True)
    start = rms(case.judge.residuals(space.start())[0])
    return {"case": case.name, "parameters": len(space), "published_heldout_rad": start, "methods": rows}


def solve(method: str, problem: Problem, case: Case) -> tuple[np.ndarray, float]:
    """Run one method; its values, and the seconds of motion that it simulated."""
    if method == "mujoco.sysid":
        from sysid_peer import fit_with_sysid

        return fit_with_sysid(problem.objective)
    entry = catalog.load("fitters", method.removesuffix(", finished"), Fitter)
    length = float(np.mean([window.times[-1] for window in problem.objective.windows]))
    extra = 0.0
    if entry.needs_surrogate:
        settings, work = SweepSettings(), cast(Work, Memory())
        counted = problem.joints if problem.joints is not None else np.ones(len(problem.objective.simulated.robot.joints), bool)
        swept = from_tables(sweep(problem.objective.simulated, windows_of(case.train, settings, work), counted, settings, work))
        learned = catalog.load("surrogates", "mlp", Surrogate).fit(swept, {}, 0)
        problem = with_surrogate(problem, swept, learned, {}, case.train)
        extra = len(swept) * settings.seconds
    result = entry.fit(problem)
    if method != FINISHED:
        return result.values, result.simulations * length + extra
    searched = problem.objective.simulations
    values = finish(problem.objective, result.values, problem.options.polish).values
    return values, (result.simulations + problem.objective.simulations - searched) * length


def so101(seconds: float) -> Case | None:
    """42 real motions; the servos share their numbers; joints 1 to 5 count."""
    shared = Path(os.environ.get("EDREAM_SHARED_DATA", Path(__file__).resolve().parents[2] / "shared" / "data")) / "so101"
    if not shared.is_dir():
        return None
    robot = RobotSettings(shared / "so101.xml", "so101", "gripperframe")
    joints = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll")
    return case_of("so101", robot, shared / "dataset", SpaceSettings(EFFECTS, (("all",),), joints=joints, until=UNTIL), seconds)


def arm6(seconds: float) -> Case:
    """Recordings of the make-believe robot, whose equations are not ours."""
    robot = RobotSettings(config.conf_folder().parent / "edream" / "robots" / "arm6.xml", "arm6", "ee")
    placed = tuple(f"{effect}@joint{i}" for effect in EFFECTS for i in range(1, 7))
    joints = tuple(f"joint{i}" for i in range(1, 7))
    with tempfile.TemporaryDirectory() as folder:
        record(robot.load(), RecordConfig(Path(folder) / "data", format="lerobot_v3"), 0)
        return case_of("arm6", robot, Path(folder) / "data", SpaceSettings(placed, joints=joints, until=UNTIL), seconds)


def case_of(name: str, settings: RobotSettings, data: Path, space: SpaceSettings, seconds: float) -> Case:
    robot = settings.load()
    found = ingest_recordings(data, robot.joints, None, MappingConfig())
    episodes = [one[0] for one in found if isinstance(one, tuple)]
    simulated = simulated_robot(robot, space)
    train, held = split_motions(episodes, space, 0)
    counted = scored(robot, space)
    objective = Objective(simulated, stretches(train, 10.0, seconds, UNTIL), counted, sampling_stride(train, 25.0))
    return Case(
        name,
        Problem(objective, options=FitterOptions(), joints=counted),
        train,
        Objective(simulated, whole(held, UNTIL), counted),
    )


def markdown(table: dict[str, Any]) -> str:
    """A table for people; ratios are against annealing, the paper's yardstick."""
    rows = table["methods"]
    base = next((row for row in rows if row["method"] == "annealing"), rows[0])
    lines = [
        f"### {table['case']}: {table['parameters']} parameters, published model off by {table['published_heldout_rad']:.4f} rad",
        "",
        f"| method | held-out [rad] | train [rad] | seconds | CPU [s] | simulated motion [s] | {base['method']}'s CPU / its | "
        f"{base['method']}'s motion / its | its error / {base['method']}'s |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        cells = f"{row['heldout_rad']:.5f} | {row['train_rad']:.5f} | {row['seconds']:.1f} | {row['cpu_seconds']:.1f}"
        ratios = f"{base['cpu_seconds'] / row['cpu_seconds']:.1f} | {base['simulated_s'] / row['simulated_s']:.1f}"
        error = row["heldout_rad"] / base["heldout_rad"]
        lines.append(f"| {row['method']} | {cells} | {row['simulated_s']:.0f} | {ratios} | {error:.2f} |")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
