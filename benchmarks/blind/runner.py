"""Phases 1 and 2 of one case: record here, diagnose in a process that gets a copy of the recordings and nothing else."""

import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import astuple
from pathlib import Path
from time import monotonic
from typing import Any

from benchmarks.blind.cases import ROOT, Case, Session, record_again, record_case, robot_of
from benchmarks.blind.score import is_resolved, is_shown, score
from benchmarks.blind.shown import shown
from edream.core.errors import EdreamError
from edream.reality.truth import unseal
from edream.sim.robot import RobotModel

LONGEST = 1800.0  # s; a diagnosis that takes longer counts as failed


def run_case(
    case: Case, robot: RobotModel, folder: Path, session: Session, baselines: bool = False, again: bool = False
) -> dict[str, Any]:
    """Record a case where that is not done, and diagnose it blindfolded.

    Args:
        case, robot: what is hidden where.
        folder: of recordings and truths.
        session: how much is recorded.
        baselines: run the baselines, too.
        again: where the diagnosis is in doubt and suggests a motion, record that and diagnose all recordings together.

    Returns:
        What the diagnosis wrote, with "baselines_failed" where only those went wrong, or {"failed": the end of what it said};
        "again" holds the second diagnosis, or None where no motion was suggested.
    """
    data, _ = record_case(case, robot, folder, session)
    with tempfile.TemporaryDirectory(prefix="blind-") as name:
        place = Path(name)
        shutil.copytree(data, place / "recordings")
        write_robot(robot, place / "robot")
        motion = place / "motion.csv"
        words = [*(["--baselines"] if baselines else []), *(["--suggest", str(motion)] if again else [])]
        result = _blindfolded(place, "result.json", words)
        if again:
            result["again"] = None
        if motion.exists():
            noted = json.loads(motion.with_suffix(".json").read_text(encoding="utf-8"))
            more = [place / f"more_{number}" for number in range(len(noted))]
            for conditions, data in zip(noted, more, strict=True):
                shutil.copytree(record_again(case, robot, folder, motion, conditions), data)
            result["again"] = {"conditions": noted} | _blindfolded(place, "again.json", ["--beside", *map(str, more)])
        return result


def _blindfolded(place: Path, name: str, words: Sequence[str]) -> dict[str, Any]:
    """What a diagnosis of the recordings at `place` writes, in a process that sees nothing else."""
    out = place / name
    given = [str(place / "robot" / "robot.xml"), str(place / "recordings"), str(out), *words]
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-m", "benchmarks.blind.explain", *given]
    try:
        done = subprocess.run(command, cwd=place, env=environment, capture_output=True, text=True, timeout=LONGEST, check=False)
    except subprocess.TimeoutExpired:
        return {"failed": f"more than {LONGEST:.0f} s"}
    said = done.stderr.strip()[-2000:]
    if done.returncode and not out.exists():
        return {"failed": said}
    result = json.loads(out.read_text(encoding="utf-8"))
    return result | ({"baselines_failed": said} if done.returncode else {})


def write_robot(robot: RobotModel, folder: Path) -> None:
    """A nominal model as a user has it: `robot.xml` and its meshes."""
    folder.mkdir()
    (folder / "robot.xml").write_text(robot.mjcf, encoding="utf-8")
    for name, content in robot.assets.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)


def finished(path: Path, session: Session) -> dict[str, dict[str, Any]]:
    """Results kept so far by case name; the last line of a case counts, a line cut short by a killed run does not."""
    kept: dict[str, dict[str, Any]] = {}
    for line in path.read_text(encoding="utf-8").splitlines() if path.exists() else []:
        try:
            one = json.loads(line)
        except json.JSONDecodeError:
            continue
        if one["session"] == list(astuple(session)):
            kept[one["case"]] = one
    return kept


def run_cases(
    chosen: Sequence[Case],
    folder: Path,
    session: Session,
    *,
    minutes: float = float("inf"),
    jobs: int = 1,
    baselines: bool = False,
    fresh: bool = False,
    again: bool = False,
    say: Callable[[str], None] = print,
) -> dict[str, dict[str, Any]]:
    """Run what is not done yet, keep each result as it comes, and return all results of the chosen cases by name."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "results.jsonl"
    kept = {} if fresh else finished(path, session)
    robots = {name: robot_of(name) for name in dict.fromkeys(case.robot for case in chosen)}
    for name in [name for name, robot in robots.items() if robot is None]:
        say(f"{name} is left out: its model comes with the measurements, which are not here (EDREAM_SHARED_DATA).")
    todo = [c for c in chosen if robots[c.robot] is not None and not _done(kept.get(c.name), baselines, again)]
    say(f"{len(chosen)} cases, {len(todo)} to do")
    end = monotonic() + 60.0 * minutes

    def one(case: Case) -> None:
        robot = robots[case.robot]
        if monotonic() > end or robot is None:
            return
        result = run_case(case, robot, folder, session, baselines, again)
        line = {"case": case.name, "code": case.code, "session": list(astuple(session)), "version": version(), **result}
        with path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(line) + "\n")
        kept[case.name] = line
        say(f"{case.name}: {summarise(scored(case, robot, folder, session, line), line)}")

    with ThreadPoolExecutor(jobs) as pool:
        list(pool.map(one, todo))
    return {case.name: kept[case.name] for case in chosen if case.name in kept}


def _done(result: Mapping[str, Any] | None, baselines: bool, again: bool) -> bool:
    if result is None or "failed" in result or (baselines and "baselines" not in result):
        return False
    return not again or result["verdict"] != "cannot_tell" or "again" in result


def scored(case: Case, robot: RobotModel, folder: Path, session: Session, result: Mapping[str, Any]) -> dict[str, Any]:
    """Phase 3 for one case.

    Raises:
        EdreamError: the recordings were made of something else than the case says.
    """
    truth = unseal(folder / "truth" / f"{case.code}.json")
    if tuple(h.name for h in truth.effects) != case.effects:
        raise EdreamError(f"The truth of case {case.name} hides {[h.name for h in truth.effects]}; remove {folder} and run again.")
    if "failed" in result:
        hidden = [f"{h.name}[{'+'.join(h.targets)}]" for h in truth.effects]
        return {
            "case": case.name,
            "sort": case.sort,
            "robot": case.robot,
            "hidden": hidden,
            "expected": hidden,
            "verdict": "failed",
            "named": [],
            "found": ["missed"] * len(hidden),
            "usual": False,
            "right": False,
            "closed": None,
            "seconds": None,
            "failed": result["failed"],
        }
    row = score(case, truth, robot.model, result)
    if case.sort == "single":
        row["shown_rad"] = shown(case, truth, robot, session, folder)
    if "again" in result and result["verdict"] == "cannot_tell":
        row["suggested"] = result["again"] is not None
    if result.get("again") is not None:
        second = None if "failed" in result["again"] else score(case, truth, robot.model, result["again"])
        row["resolved"] = second is not None and is_resolved(second)
        row["again"] = second
    return row


def summarise(row: Mapping[str, Any], result: Mapping[str, Any]) -> str:
    """One line about a finished case."""
    if row["verdict"] == "failed":
        return f"FAILED {row['failed'].splitlines()[-1] if row['failed'] else ''}"
    faint = "" if is_shown(row) else ", which changes less than the noise"
    mark = "right" if row["right"] else "WRONG"
    hidden = ", ".join(row["hidden"]) or "nothing"
    lost = ", baselines FAILED" if "baselines_failed" in result else ""
    more = ""
    if "resolved" in row:
        then = row["again"]
        said = "failed" if then is None else f"{then['verdict']} {', '.join(then['named'])}"
        more = f"; with the suggested motion {'resolved' if row['resolved'] else 'NOT resolved'}, {said}"
    return f"{mark}, {row['verdict']} {', '.join(row['named'])} (hidden {hidden}{faint}), {row['seconds']:.0f} s{lost}{more}"


def version() -> str:
    """The commit that made a result, with a plus where the tree differs from it."""
    said = subprocess.run(["git", "describe", "--always", "--dirty=+"], cwd=ROOT, capture_output=True, text=True, check=False)
    return said.stdout.strip() or "unknown"
