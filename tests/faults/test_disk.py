import os
import resource
import subprocess
from pathlib import Path

import pytest
import small_stages

from edream import pipeline
from edream.core.errors import EdreamError
from edream.store import Store


@pytest.fixture(autouse=True)
def stages(monkeypatch) -> None:
    own = pipeline.stage
    monkeypatch.setattr(pipeline, "stage", lambda name: small_stages.STAGES.get(name) or own(name))


def make(runs: Path, **options):
    return pipeline.make_run("total", ("total",), small_stages.settings(runs, run="test", **options))[0]["total"]


def flip(path: Path, place: int, bit: int = 0) -> None:
    raw = bytearray(path.read_bytes())
    raw[place] ^= 1 << bit
    path.chmod(0o644)
    path.write_bytes(bytes(raw))


def test_a_flipped_bit_anywhere_is_named_by_verify(tmp_path) -> None:
    make(tmp_path)
    files = sorted(path for path in tmp_path.rglob("*") if path.is_file() and ".locks" not in path.parts)
    assert len(files) > 10
    for path in files:
        good = path.read_bytes()
        for place in {0, len(good) // 3, len(good) // 2, len(good) - 1}:
            for bit in (0, 5):
                flip(path, place, bit)
                problems = Store(tmp_path).verify()
                assert any(str(path) in problem for problem in problems), f"byte {place} of {path}"
                path.write_bytes(good)
    assert Store(tmp_path).verify() == []


def test_a_corrupt_input_is_named_before_it_is_used(tmp_path) -> None:
    artifact = make(tmp_path)
    parents = pipeline.chain(Store(tmp_path), artifact)
    broken = parents["mix"].folder / "parts" / "3.bin"
    flip(broken, 7)
    with pytest.raises(EdreamError, match=str(broken)):
        pipeline.chain(Store(tmp_path), artifact)["mix"].path("parts/3.bin")


def test_removing_a_corrupt_artifact_makes_it_anew_with_the_same_digest(tmp_path) -> None:
    import shutil

    digest = make(tmp_path).digest
    shutil.rmtree(next((tmp_path / "mix").glob("[0-9a-f]*")))
    assert "does not exist" in Store(tmp_path).verify()[0]
    assert make(tmp_path).digest == digest


def test_a_file_size_limit_gives_one_sentence_and_keeps_finished_work(start, undisturbed, tmp_path) -> None:
    process = start(tmp_path, preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (2000, 2000)))
    _, errors = process.communicate(timeout=120)
    assert errors.strip().splitlines()[-1].startswith("edream.core.errors.EdreamError: Cannot write")
    assert "file size limit" in errors
    kept = list(tmp_path.glob("grow/.work-*/values/0*"))
    assert len(kept) == 8
    assert not list(tmp_path.rglob(".tmp-*"))
    out, _ = start(tmp_path).communicate(timeout=120)
    assert out.strip() == undisturbed


def test_a_full_disk_gives_one_sentence_and_keeps_finished_work(start, undisturbed, tmp_path) -> None:
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", str(tmp_path)], capture_output=True, text=True)
    if mounted.returncode:
        pytest.skip(f"no small disk can be mounted here: {mounted.stderr.strip()}")
    try:
        _, errors = start(tmp_path).communicate(timeout=120)
        assert "Cannot write" in errors and "the disk is full" in errors
        assert Store(tmp_path).verify() == []
        assert not list(tmp_path.rglob(".tmp-*"))
        subprocess.run(["mount", "-o", "remount,size=8m", str(tmp_path)], check=True)
        out, errors = start(tmp_path).communicate(timeout=120)
        assert out.strip() == undisturbed, errors
    finally:
        subprocess.run(["umount", str(tmp_path)], check=True)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_that_may_not_be_written_gives_one_sentence(tmp_path) -> None:
    tmp_path.chmod(0o500)
    with pytest.raises(EdreamError, match="you may not write there"):
        make(tmp_path / "runs")


def test_runs_below_a_file_gives_one_sentence(tmp_path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(EdreamError, match="no folder can be made there"):
        make(tmp_path / "file" / "runs")


def test_gc_refuses_while_a_process_is_at_work(tmp_path) -> None:
    make(tmp_path)
    with Store(tmp_path).session(), pytest.raises(EdreamError, match="at work"):
        Store(tmp_path).gc()


def test_gc_keeps_what_a_run_names_with_all_its_parents_and_removes_the_rest(tmp_path) -> None:
    pipeline.make("total", small_stages.settings(tmp_path, seed=1))
    kept = make(tmp_path)
    removed = Store(tmp_path).gc()
    assert len(removed) == 3
    assert set(pipeline.chain(Store(tmp_path), kept)) == {"grow", "mix", "total"}
    assert Store(tmp_path).verify() == []
    assert len(Store(tmp_path).gc(["test"])) == 3
