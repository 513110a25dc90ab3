import random
import shutil
import signal
import subprocess
import time
from pathlib import Path

import pytest

from edream.store import Store

FAILPOINTS = [
    "write",
    "write:4",
    "fsync:3",
    "manifest:2",
    "manifest:9",
    "rename:1",
    "rename:9",
    "renamed:5",
    "renamed:9",
    "renamed:18",
    "run",
]


def finish(start, runs: Path, workers: int = 1) -> str:
    process = start(runs, workers)
    out, errors = process.communicate(timeout=120)
    assert process.returncode == 0, errors
    return out.strip()


def test_fifty_kills_at_random_moments_leave_the_same_result_and_no_corrupt_file(start, undisturbed, tmp_path) -> None:
    rng = random.Random(5)
    begun = time.monotonic()
    finish(start, tmp_path / "timing")
    length = time.monotonic() - begun
    killed = finished = 0
    runs = tmp_path / "runs"
    while killed < 50:
        process = start(runs)
        try:
            process.wait(rng.uniform(0.35, 1.05) * length)
        except subprocess.TimeoutExpired:
            process.send_signal(signal.SIGKILL)
            killed += 1
        out, errors = process.communicate()
        assert Store(runs).verify() == []
        if process.returncode == 0:
            assert out.strip() == undisturbed, errors
            finished += 1
            shutil.rmtree(runs)
        elif process.returncode != -signal.SIGKILL:
            pytest.fail(errors)
    assert finish(start, runs) == undisturbed
    assert finished > 0, "every run was killed; none came to its end, so resuming was not shown"


def test_a_kill_of_the_parent_of_worker_processes_leaves_the_same_result(start, undisturbed, tmp_path) -> None:
    process = start(tmp_path, 2)
    shards = tmp_path / "grow"
    for _ in range(3000):
        if list(shards.glob(".work-*/values/0*")):
            break
        time.sleep(0.005)
    process.kill()
    process.communicate()
    assert finish(start, tmp_path, 2) == undisturbed
    assert Store(tmp_path).verify() == []


@pytest.mark.parametrize("failpoint", FAILPOINTS)
def test_a_kill_between_write_flush_and_rename_leaves_the_same_result(start, undisturbed, tmp_path, failpoint) -> None:
    process = start(tmp_path, failpoint=failpoint)
    process.communicate(timeout=120)
    assert process.returncode == -signal.SIGKILL, "the failpoint was not reached"
    assert Store(tmp_path).verify() == []
    assert finish(start, tmp_path) == undisturbed
    assert Store(tmp_path).verify() == []
    assert not list(tmp_path.glob("*/.tmp-*"))


def test_a_resumed_run_keeps_its_finished_shards(start, undisturbed, tmp_path) -> None:
    start(tmp_path, failpoint="rename:6").communicate(timeout=120)
    kept = {path: path.stat().st_ino for path in tmp_path.glob("grow/.work-*/values/0*")}
    assert len(kept) == 5
    start(tmp_path, failpoint="rename:2").communicate(timeout=120)
    assert {path: path.stat().st_ino for path in kept} == kept
    assert finish(start, tmp_path) == undisturbed


def test_of_two_processes_at_once_one_works_and_one_waits_and_finds_the_result(start, undisturbed, tmp_path) -> None:
    pair = [start(tmp_path), start(tmp_path)]
    results = [process.communicate(timeout=120) for process in pair]
    assert [out.strip() for out, _ in results] == [undisturbed, undisturbed]
    assert len(list(tmp_path.glob("*/*/manifest.json"))) == 3
    assert Store(tmp_path).verify() == []
