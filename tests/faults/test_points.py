"""Kills at every point of every write, and hundreds at random moments; what a store that is shared, read-only or broken does.

make faults FAULT_KILLS=500     counts and prints the kills
"""

import multiprocessing
import os
import random
import shutil
import subprocess
import time
from pathlib import Path

import pytest
import small_stages

from edream import pipeline
from edream.core.errors import EdreamError
from edream.store import Store

POINTS = ("write", "written", "fsync", "manifest", "flush", "rename", "renamed", "run", "named")
KILLS = int(os.environ.get("EDREAM_FAULT_KILLS", "60"))
KILLED = -9
FORKS = multiprocessing.get_context("forkserver")  # a process begins in a hundredth of a second, everything imported
FORKS.set_forkserver_preload(["small_stages"])


def begin(runs: Path, failpoint: str | None = None, slow: float = 0.0):
    out = runs.with_name(runs.name + ".digest")
    process = FORKS.Process(target=small_stages.once, args=(str(runs), failpoint, str(out), slow))
    process.start()
    return process, out


def finished(runs: Path) -> str:
    process, out = begin(runs)
    process.join(120)
    assert process.exitcode == 0
    return out.read_text()


def checked(runs: Path, undisturbed: str) -> None:
    """What is there is whole; what is made of it is what an undisturbed run makes."""
    assert Store(runs).verify() == []
    assert finished(runs) == undisturbed
    assert Store(runs).verify() == [] and not list(runs.glob("*/.tmp-*"))


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("point", POINTS)
def test_a_kill_at_each_passing_of_each_point_leaves_the_same_result(point, undisturbed, tmp_path, capsys) -> None:
    kills = 0
    while True:
        runs = tmp_path / str(kills)
        process, _ = begin(runs, f"{point}:{kills + 1}")
        process.join(120)
        if process.exitcode == 0:
            break
        assert process.exitcode == KILLED
        checked(runs, undisturbed)
        shutil.rmtree(runs)
        kills += 1
    assert kills >= 1, "the point was never reached"
    with capsys.disabled():
        print(f" {kills} kills at {point!r}, 0 artifacts lost or wrong", flush=True)


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_kills_at_random_moments_one_after_another_in_one_store_lose_nothing(undisturbed, tmp_path, capsys) -> None:
    rng, killed, done = random.Random(11), 0, 0
    runs = tmp_path / "runs"
    clock = time.monotonic()
    begin(tmp_path / "timing", slow=0.01)[0].join(120)
    length = time.monotonic() - clock
    while killed < KILLS:
        process, out = begin(runs, slow=0.01)
        process.join(rng.uniform(0.02, 1.0) * length)
        if process.is_alive():
            process.kill()
            killed += 1
        process.join()
        assert Store(runs).verify() == []
        if process.exitcode == 0:
            assert out.read_text() == undisturbed
            done += 1
            shutil.rmtree(runs)
    checked(runs, undisturbed)
    assert done > 0, "no run came to its end between kills"
    with capsys.disabled():
        print(
            f" {killed} kills at random moments, {done + 1} runs came to their end in between, 0 artifacts lost or wrong",
            flush=True,
        )


@pytest.mark.parametrize("count", [2, 8])
def test_of_many_processes_at_once_one_works_and_all_have_the_result(count, undisturbed, tmp_path) -> None:
    pairs = []
    for number in range(count):
        out = tmp_path / f"{number}.digest"
        process = FORKS.Process(target=small_stages.once, args=(str(tmp_path / "runs"), None, str(out), 0.004))
        process.start()
        pairs.append((process, out))
    for process, out in pairs:
        process.join(120)
        assert process.exitcode == 0 and out.read_text() == undisturbed
    assert len(list((tmp_path / "runs").glob("*/*/manifest.json"))) == 3
    assert Store(tmp_path / "runs").verify() == []


def test_a_clock_that_jumps_back_changes_nothing(start, undisturbed, tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("EDREAM_TEST_CLOCK", "-365")
    process = start(tmp_path, failpoint="renamed:5")
    process.communicate(timeout=120)
    kept = {path: path.stat().st_ino for path in tmp_path.glob("*/.work-*/values/0*")}
    assert kept
    for days in ("400", "-4000"):
        monkeypatch.setenv("EDREAM_TEST_CLOCK", days)
        out, errors = start(tmp_path).communicate(timeout=120)
        assert out.strip() == undisturbed, errors
    made = [one.manifest["made"]["at"][:4] for one in Store(tmp_path).artifacts()]
    assert len(made) == 3 and len(set(made)) > 1, "the clock did jump"


def test_a_read_only_store_is_read_and_refuses_in_one_sentence_to_be_written(start, undisturbed, tmp_path) -> None:
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=8m", "tmpfs", str(tmp_path)], capture_output=True, text=True)
    if mounted.returncode:
        pytest.skip(f"nothing can be mounted here: {mounted.stderr.strip()}")
    try:
        assert start(tmp_path).communicate(timeout=120)[0].strip() == undisturbed
        subprocess.run(["mount", "-o", "remount,ro", str(tmp_path)], check=True)
        out, errors = start(tmp_path).communicate(timeout=120)
        assert out.strip() == undisturbed, errors
        subprocess.run(["mount", "-o", "remount,rw", str(tmp_path)], check=True)
        shutil.rmtree(next((tmp_path / "total").glob("[0-9a-f]*")))
        subprocess.run(["mount", "-o", "remount,ro", str(tmp_path)], check=True)
        _, errors = start(tmp_path).communicate(timeout=120)
        assert errors.strip().splitlines()[-1].startswith("edream.core.errors.EdreamError: Cannot write")
        assert "read-only disk" in errors
        subprocess.run(["mount", "-o", "remount,rw", str(tmp_path)], check=True)
        assert start(tmp_path).communicate(timeout=120)[0].strip() == undisturbed
    finally:
        subprocess.run(["umount", str(tmp_path)], check=True)


def half_made(start, runs: Path) -> list[Path]:
    """Shards of a run that was killed while it made them."""
    start(runs, failpoint="rename:6").communicate(timeout=120)
    return sorted(runs.glob("grow/.work-*/values/0*"))


def test_a_shard_that_is_gone_is_made_again(start, undisturbed, tmp_path) -> None:
    shards = half_made(start, tmp_path)
    shutil.rmtree(shards[2])
    assert start(tmp_path).communicate(timeout=120)[0].strip() == undisturbed


def test_a_shard_whose_bytes_changed_is_one_sentence_that_says_what_to_do(start, undisturbed, tmp_path) -> None:
    shard = half_made(start, tmp_path)[2]
    path = shard / "values.safetensors"
    path.chmod(0o644)
    path.write_bytes(path.read_bytes()[:-1] + b"\x00")
    _, errors = start(tmp_path).communicate(timeout=120)
    assert f"EdreamError: {path} is corrupt" in errors and f"Remove the folder {shard}" in errors
    shutil.rmtree(shard)
    assert start(tmp_path).communicate(timeout=120)[0].strip() == undisturbed


def test_an_upstream_artifact_whose_file_is_gone_or_changed_is_one_sentence_and_is_made_anew_once_removed(
    start, undisturbed, tmp_path, monkeypatch
) -> None:
    own = pipeline.stage
    monkeypatch.setattr(pipeline, "stage", lambda name: small_stages.STAGES.get(name) or own(name))

    def make() -> str:
        return pipeline.make_run("total", ("total",), small_stages.settings(tmp_path, run="test"))[0]["total"].digest

    assert make() == undisturbed
    for what in ("gone", "changed"):
        shutil.rmtree(next((tmp_path / "total").glob("[0-9a-f]*")))
        mixed = next((tmp_path / "mix").glob("[0-9a-f]*"))
        part = mixed / "parts" / "3.bin"
        part.chmod(0o644)
        if what == "gone":
            part.unlink()
        else:
            part.write_bytes(part.read_bytes()[::-1])
        with pytest.raises(EdreamError, match=f"{part} is (missing|corrupt)"):
            make()
        shutil.rmtree(mixed)
        assert make() == undisturbed
