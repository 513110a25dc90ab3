"""The real stages on a small record, killed at random: what comes out in the end is what an undisturbed run makes.

make faults     or     python -m pytest -m slow tests/faults/test_kill_real.py
"""

import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from edream.store import Store

pytestmark = [pytest.mark.slow, pytest.mark.timeout(3600)]
KILLS = 50
STAGES = ("ingest", "sweep", "surrogate", "fit")
SMALL = [
    "robot=pan_tilt",
    "fit.method=surrogate",
    "fit.seconds=6",
    "fit.stretch=2",
    "sweep.sets=16",
    "sweep.rounds=2",
    "sweep.windows=16",
    "sweep.blocks=8",
    "fit.search.descent_steps=10",
    "fit.search.polish=2",
    "fit.search.iterations=3",
    "surrogate.options={hidden: 16, epochs: 2}",
    "run=killed",
]


def start(command: str, arguments: list[str]) -> subprocess.Popen:
    """The command line as a process of its own."""
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2]), "OMP_NUM_THREADS": "1"}
    program = [sys.executable, "-c", "from edream.cli import main; main()", command, *arguments]
    return subprocess.Popen(program, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def finish(data: Path, runs: Path) -> dict[str, str]:
    """Calibrate to the end; the content of every stage's artifact by its logical digest."""
    process = start("calibrate", [*SMALL, f"data={data}", f"runs={runs}", "--json"])
    out, errors = process.communicate(timeout=600)
    assert process.returncode == 0, errors
    json.loads(out)
    return digests(runs)


def digests(runs: Path) -> dict[str, str]:
    store = Store(runs)
    assert store.verify() == []
    return {artifact.stage: artifact.digest for artifact in store.artifacts()}


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("record") / "recorded"
    process = start("record", ["robot=pan_tilt", f"record.out={path}", "record.motions=4", "record.seconds=3", "seed=3"])
    assert process.wait(timeout=120) == 0
    return path


def wait_for(stage: str, process: subprocess.Popen, runs: Path) -> bool:
    """Wait until a process holds the lock of a stage, which it does while it works on it; False where it ends first."""
    lock = str(runs / ".locks" / f"{stage}-")
    while process.poll() is None:
        try:
            opened = [os.readlink(file) for file in Path(f"/proc/{process.pid}/fd").iterdir()]
        except OSError:  # a file was closed in between
            continue
        if any(file.startswith(lock) for file in opened):
            return True
        time.sleep(0.005)
    return False


def test_fifty_kills_in_ingest_sweep_surrogate_and_fit_leave_the_digests_of_an_undisturbed_run(data: Path, tmp_path: Path) -> None:
    undisturbed = finish(data, tmp_path / "undisturbed")
    lengths = {one.stage: float(one.manifest["made"]["seconds"]) for one in Store(tmp_path / "undisturbed").artifacts()}
    assert set(STAGES) <= set(lengths)
    rng, hit, rounds = random.Random(7), dict.fromkeys(STAGES, 0), 0
    while sum(hit.values()) < KILLS:
        runs = tmp_path / f"runs{rounds}"
        rounds += 1
        for stage in (stage for stage in STAGES for _ in range(4)):
            process = start("calibrate", [*SMALL, f"data={data}", f"runs={runs}", "--json"])
            if wait_for(stage, process, runs):
                time.sleep(rng.uniform(0.0, lengths[stage]))
                process.send_signal(signal.SIGKILL)
            process.communicate()
            if process.returncode == -signal.SIGKILL:
                hit[stage] += 1
            assert Store(runs).verify() == []
        assert finish(data, runs) == undisturbed
    print(f"{sum(hit.values())} kills over {rounds} calibrations, by the stage that was at work: {hit}")


def test_of_two_calibrations_at_once_one_works_and_one_waits_and_finds_the_result(data: Path, tmp_path: Path) -> None:
    pair = [start("calibrate", [*SMALL, f"data={data}", f"runs={tmp_path}", "--json"]) for _ in range(2)]
    results = [process.communicate(timeout=900) for process in pair]
    assert [process.returncode for process in pair] == [0, 0], results
    models = [json.loads(out)["model"] for out, _ in results]
    assert models[0] == models[1]
    made = [artifact.stage for artifact in Store(tmp_path).artifacts()]
    assert sorted(made) == sorted(set(made)), "something was made twice"
    assert Store(tmp_path).verify() == []


def test_a_flipped_bit_in_a_real_artifact_is_named(data: Path, tmp_path: Path) -> None:
    finish(data, tmp_path)
    victim = next(tmp_path.glob("fit/*/replay.parquet"))
    content = bytearray(victim.read_bytes())
    content[len(content) // 2] ^= 4
    os.chmod(victim, 0o644)
    victim.write_bytes(bytes(content))
    process = start("verify", [f"runs={tmp_path}"])
    out, _ = process.communicate(timeout=60)
    assert process.returncode == 2
    assert "replay.parquet" in out
