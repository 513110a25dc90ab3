"""From the command line to the store, on a small make-believe robot."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

PROGRAM = [sys.executable, "-c", "import sys; sys.argv[0] = 'edream'; from edream.cli import main; main()"]


def edream(*arguments: object) -> dict:
    done = subprocess.run([*PROGRAM, *map(str, arguments), "--json"], capture_output=True, text=True, timeout=280)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("recorded") / "data"
    edream("record", "robot=pan_tilt", f"record.out={out}", "record.motions=4", "record.seconds=4", "seed=1")
    return out


@pytest.fixture(scope="module")
def settings(recorded, tmp_path_factory) -> list[str]:
    runs = tmp_path_factory.mktemp("runs")
    return ["robot=pan_tilt", f"data={recorded}", f"runs={runs}"]


def test_recordings_become_episodes_and_the_second_call_finds_them(settings) -> None:
    first = edream("ingest", *settings)
    assert first["episodes"] == 4 and first["malformed"] == []
    assert Path(first["index"]).is_file()
    before = {path: path.stat().st_mtime_ns for path in Path(first["artifact"]).rglob("*")}
    assert edream("ingest", *settings) == first
    assert {path: path.stat().st_mtime_ns for path in Path(first["artifact"]).rglob("*")} == before


def test_the_seed_and_the_place_of_the_data_do_not_change_what_ingest_makes(settings, recorded, tmp_path) -> None:
    import shutil

    first = edream("ingest", *settings)
    shutil.copytree(recorded, tmp_path / "moved")
    moved = [f"data={tmp_path / 'moved'}" if one.startswith("data=") else one for one in settings]
    assert edream("ingest", *moved, "seed=7")["artifact"] == first["artifact"]


def test_status_says_which_setting_of_a_key_changed(settings) -> None:
    edream("ingest", *settings)
    plan = {step["stage"]: step for step in edream("status", *settings, "ingest.command_shift=1")["plan"]}
    assert plan["ingest"]["state"] == "not made"
    assert plan["ingest"]["changed"] == ["config.ingest.command_shift: 0 -> 1"]


def test_an_export_ingests_to_the_same_numbers(settings, tmp_path) -> None:
    import numpy as np

    from edream.ingest.stored import stored_episodes
    from edream.store import StoredArtifact

    first = edream("ingest", *settings)
    exported = edream("export", "--out", tmp_path / "lerobot", *settings)
    again = edream("ingest", *[f"data={exported['data']}" if one.startswith("data=") else one for one in settings])
    pairs = [stored_episodes(StoredArtifact(Path(made["artifact"]))) for made in (first, again)]
    for one, two in zip(*pairs, strict=True):
        np.testing.assert_allclose(two.position, one.position, atol=1e-6)
        np.testing.assert_allclose(two.command, one.command, atol=1e-6)


def test_verify_finds_everything_as_written(settings) -> None:
    edream("ingest", *settings)
    runs = next(one for one in settings if one.startswith("runs="))
    assert edream("verify", runs) == {"ok": True, "problems": []}


def test_ways_to_fit_stand_side_by_side_as_fits_of_their_own_and_are_not_made_twice(settings) -> None:
    small = [*settings, "fit.seconds=4", "fit.stretch=2", "fit.search.evaluations=20"]
    first = edream("calibrate", *small, "fit.compare=[cmaes,gauss_newton]")
    assert [row["method"] for row in first["methods"]] == ["gauss_newton", "cmaes"]
    for row in first["methods"]:
        assert row["heldout_rad"] > 0 and row["seconds"] > 0 and row["simulations"] > 0
    page = Path(first["report"]).read_text()
    assert "Ways to fit" in page and "<td>cmaes</td>" in page
    assert edream("calibrate", *small, "fit.compare=[cmaes,gauss_newton]") == first
    alone = edream("calibrate", *small, "fit.method=cmaes")
    assert alone["simulations"] == first["methods"][1]["simulations"] and "methods" not in alone
    runs = next(one for one in settings if one.startswith("runs="))
    artifacts = [one["artifact"] for one in edream("status", runs)["artifacts"]]
    assert len([one for one in artifacts if one.startswith("fit/")]) == 2
    assert edream("gc", runs)["removed"] == []


def test_a_method_to_compare_with_that_does_not_exist_is_told_before_anything_is_made(recorded, tmp_path) -> None:
    wrong = ["robot=pan_tilt", f"data={recorded}", f"runs={tmp_path}", "fit.compare=[cmaess]"]
    done = subprocess.run([*PROGRAM, "calibrate", *wrong], capture_output=True, text=True, timeout=60)
    assert done.returncode == 2 and "Did you mean 'cmaes'?" in done.stderr
    assert not list(tmp_path.glob("*/*"))


def test_report_finds_the_page_of_the_newest_calibration_and_writes_it_anew_where_it_is_gone(settings) -> None:
    import shutil

    made = edream("calibrate", *settings, "fit.seconds=4", "fit.stretch=2")
    runs = next(one for one in settings if one.startswith("runs="))
    found = edream("report", runs)
    assert found["report"] == made["report"] and found["artifact"] == made["artifact"]
    page = Path(made["report"]).read_text()
    shutil.rmtree(Path(made["report"]).parent)
    assert Path(edream("report", runs)["report"]).read_text() == page
