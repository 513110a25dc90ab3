"""Demonstrations: only successes, the same again with the same seed, the same robot as for motions, and no word of the truth."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from edream import catalog
from edream.core.camera import from_json
from edream.core.episode import Recording
from edream.core.errors import EdreamError
from edream.core.format import Format, ReadOptions
from edream.core.scene import scene_from_json
from edream.reality.cell_look import CellLook
from edream.reality.truth import unseal
from edream.record import RecordConfig, record
from edream.record_task import record_task
from tests.workcells import robot

SMALL = CellLook(("cam_high",), 32, 32)


def read(folder: Path) -> list[Recording]:
    form = catalog.load("formats", "aloha_hdf5", Format)
    return [one for one in form.recordings(folder, ReadOptions()) if isinstance(one, Recording)]


@pytest.fixture(scope="module")
def demonstrations(tmp_path_factory: pytest.TempPathFactory, rendering: None) -> tuple[Path, dict]:
    out = tmp_path_factory.mktemp("tasks") / "demos"
    told = record_task(robot(), "grab_paper_cup", RecordConfig(out, episodes=2, cell=SMALL), seed=4)
    return out, told


def test_demonstrations_hold_joints_commands_and_images(demonstrations: tuple[Path, dict]) -> None:
    out, told = demonstrations
    found = read(out)
    assert len(found) == told["recordings"] == 2
    for one in found:
        assert one.position.shape == one.command.shape == (150, 7)
        images = np.stack(list(one.videos["cam_high"].frames()))
        assert images.shape == (150, 32, 32, 3) and images.std() > 10.0
        assert 0.01 < np.abs(one.position - one.command)[:, :6].max() < 0.6
        assert one.command[:, 6].min() < 0.04 < one.command[0, 6]  # the gripper closes


def test_what_lies_beside_fits_the_recordings(demonstrations: tuple[Path, dict]) -> None:
    out, told = demonstrations
    scene = scene_from_json(json.loads(Path(told["scene"]).read_text()), "scene")
    assert set(scene.tracks or {}) == {one.name for one in read(out)}
    poses = [track["cup"].poses for track in (scene.tracks or {}).values()]
    assert all(pose[-1, 2] - pose[0, 2] > 0.05 for pose in poses)
    camera = from_json(json.loads(Path(told["cameras"]).read_text()), "cameras")["cam_high"]
    assert (camera.height, camera.width) == (32, 32)
    assert Path(told["plate"]).is_file()


def test_no_file_beside_the_sealed_truth_names_an_effect(demonstrations: tuple[Path, dict]) -> None:
    told = demonstrations[1]
    hidden = {one.name for one in unseal(Path(told["truth"])).effects}
    assert hidden and not any(name in json.dumps(told) for name in hidden)


def test_the_same_seed_records_the_same_again(demonstrations: tuple[Path, dict], tmp_path: Path) -> None:
    record_task(robot(), "grab_paper_cup", RecordConfig(tmp_path / "again", episodes=1, cell=SMALL), seed=4)
    for one, two in zip(read(demonstrations[0])[:1], read(tmp_path / "again"), strict=True):
        assert np.array_equal(one.position, two.position) and np.array_equal(one.command, two.command)
        assert all(np.array_equal(a, b) for a, b in zip(*(x.videos["cam_high"].frames() for x in (one, two)), strict=True))


@pytest.mark.slow
def test_workers_change_nothing(rendering: None, tmp_path: Path) -> None:
    for workers in (1, 2):
        record_task(
            robot(), "grab_paper_cup", RecordConfig(tmp_path / str(workers), episodes=6, cell=SMALL), seed=5, workers=workers
        )
    for one, two in zip(read(tmp_path / "1"), read(tmp_path / "2"), strict=True):
        assert np.array_equal(one.command, two.command)
        assert all(np.array_equal(a, b) for a, b in zip(*(x.videos["cam_high"].frames() for x in (one, two)), strict=True))


def test_motions_are_of_the_same_robot_by_seed_or_by_its_truth(demonstrations: tuple[Path, dict], tmp_path: Path) -> None:
    truth = Path(demonstrations[1]["truth"])
    by_seed = record(robot(), RecordConfig(tmp_path / "one", effects=("drawn",), motions=1, seconds=1.0), seed=4)
    by_truth = record(robot(), RecordConfig(tmp_path / "two", truth=truth, motions=1, seconds=1.0), seed=9)
    assert unseal(Path(by_seed["truth"])) == unseal(Path(by_truth["truth"])) == replace(unseal(truth), cameras={})
    assert CellLook.of(unseal(truth).cameras) == SMALL, "whoever evaluates looks through the cameras that recorded"


def test_an_encoder_that_lies_does_not_mislead_the_expert(tmp_path: Path) -> None:
    config = RecordConfig(tmp_path / "demos", effects=("encoder_offset",), episodes=2, cell=CellLook(()))
    assert record_task(robot(), "grab_paper_cup", config, seed=1)["tried"] <= 3


def test_a_task_or_robot_that_does_not_exist_is_named(tmp_path: Path) -> None:
    with pytest.raises(EdreamError, match="grab_paper_cup"):
        record_task(robot(), "grab_paper_cap", RecordConfig(tmp_path / "demos"))
    with pytest.raises(EdreamError, match="truth of robot"):
        told = record(robot(), RecordConfig(tmp_path / "one", motions=1, seconds=1.0))
        record_task(robot("cobot"), "grab_paper_cup", RecordConfig(tmp_path / "two", truth=Path(told["truth"])))
