"""Episode files, their index, and what may lie about on disk."""

import hashlib
import json
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from edream.core.episode import Episode, Video
from edream.core.errors import EdreamError
from edream.core.format import Malformed, ReadOptions, Recording
from edream.ingest.episode_file import write_episode
from edream.ingest.episode_read import read_episode
from edream.ingest.findings import find
from edream.ingest.index import file_name, index_row, read_index, write_index
from edream.ingest.lerobot_write import export_lerobot
from edream.ingest.mapping import MappingConfig, map_recording
from edream.ingest.recordings import ingest_recordings, read_recordings
from tests.recordings import make_sample, sample_episode

JOINTS = ("shoulder", "elbow")


def rich_episode() -> Episode:
    rng = np.random.default_rng(0)
    plain = sample_episode()
    rows = len(plain.times)
    images = rng.integers(0, 255, (rows, 12, 14, 3), dtype=np.uint8)
    poses = np.tile(np.eye(4), (rows, 1, 1))
    poses[:, :3, 3] = rng.normal(size=(rows, 3))
    video = Video(plain.times, 12, 14, lambda: iter(images), np.array([[9.1, 0, 7], [0, 9.2, 6], [0, 0, 1]]), poses)
    return replace(
        plain,
        position=rng.normal(size=(rows, 2)),
        velocity=rng.normal(size=(rows, 2)),
        command_times=plain.times - 0.007,
        enabled=np.arange(rows) % 7 < 5,
        videos={"front": video},
        conditions={"gain": 0.1 + 0.2},
        notes={"task": "wave, \u00e4"},
    )


def test_an_episode_file_gives_every_number_back_exactly(tmp_path: Path) -> None:
    before = rich_episode()
    before = replace(before, command_times=np.round(before.command_times * 1e9) / 1e9)
    write_episode(before, tmp_path / "a.mcap", {"source": "here"}, {"seed": 1})
    after = read_episode(tmp_path / "a.mcap")
    for what in ("times", "position", "command_times", "command", "velocity", "enabled"):
        np.testing.assert_array_equal(getattr(after, what), getattr(before, what), err_msg=what)
    assert after.effort is None and after.joints == before.joints and after.name == before.name
    assert dict(after.conditions) == dict(before.conditions) and dict(after.notes) == dict(before.notes)
    mine, read = before.videos["front"], after.videos["front"]
    np.testing.assert_array_equal(read.times, mine.times)
    assert mine.intrinsics is not None and mine.extrinsics is not None
    np.testing.assert_array_equal(read.intrinsics, mine.intrinsics)
    np.testing.assert_array_equal(read.extrinsics, mine.extrinsics)
    for first, second in zip(mine.frames(), read.frames(), strict=True):
        np.testing.assert_array_equal(first, second)


def test_the_same_episode_gives_the_same_bytes(tmp_path: Path) -> None:
    files = [tmp_path / "a.mcap", tmp_path / "b.mcap"]
    for file in files:
        write_episode(rich_episode(), file)
    assert len({hashlib.sha256(file.read_bytes()).hexdigest() for file in files}) == 1


def test_an_episode_whose_images_end_early_leaves_no_file(tmp_path: Path) -> None:
    episode = sample_episode()
    short = Video(episode.times, 4, 4, lambda: iter([np.zeros((4, 4, 3), np.uint8)]))
    with pytest.raises(EdreamError, match="has 1 images for 25 times"):
        write_episode(replace(episode, videos={"front": short}), tmp_path / "a.mcap")
    assert not list(tmp_path.iterdir())


def test_the_index_reads_back_and_names_no_file_outside(tmp_path: Path) -> None:
    episode = rich_episode()
    write_episode(episode, tmp_path / "wave.mcap")
    row = index_row(episode, tmp_path / "wave.mcap")
    write_index([row], tmp_path)
    assert read_index(tmp_path) == [row]
    write_index([replace(row, file="../wave.mcap")], tmp_path)
    with pytest.raises(EdreamError, match="beside the index"):
        read_index(tmp_path)


def test_file_names_are_safe_and_differ() -> None:
    assert file_name("a/b c") == "a_b_c.mcap"
    assert file_name("a/b c", ["a_b_c.mcap"]) == "a_b_c-2.mcap"
    assert file_name("../..") == "_...mcap"


def test_our_mcap_passes_the_doctor(tmp_path: Path) -> None:
    pytest.importorskip("pymcap_cli")
    for number, episode in enumerate((sample_episode(), rich_episode())):
        write_episode(episode, tmp_path / f"{number}.mcap")
        doctor = Path(sys.executable).with_name("pymcap-cli")
        done = subprocess.run([doctor, "doctor", tmp_path / f"{number}.mcap"], capture_output=True, text=True)
        assert done.returncode == 0 and "warning" not in done.stdout.lower(), done.stdout


@pytest.mark.parametrize("images", ["image", "video"])
def test_our_lerobot_export_passes_the_doctor(tmp_path: Path, images: str) -> None:
    pytest.importorskip("lerobot_doctor")
    episode = rich_episode()
    export_lerobot([replace(episode, command_times=episode.times)] * 2, tmp_path / "set", images)
    doctor = Path(sys.executable).with_name("lerobot-doctor")
    done = subprocess.run([doctor, "check", tmp_path / "set", "--ci", "--json"], capture_output=True, text=True)
    report = json.loads(done.stdout)
    assert done.returncode == 0, [check for check in report["checks"] if check["severity"] == "FAIL"]
    assert len(list(read_recordings(tmp_path / "set"))) == 2


def test_conditions_come_along_and_unknown_names_are_reported(tmp_path: Path) -> None:
    path = make_sample("mcap_ros2", tmp_path)
    (path / "conditions.csv").write_text("recording,firmware_gain,payload\nwave,200,\nwafe,1,2\n")
    found = list(ingest_recordings(path, JOINTS))
    assert isinstance(found[0], tuple) and dict(found[0][0].conditions) == {"firmware_gain": 200.0}
    assert isinstance(found[1], Malformed) and found[1].name == "wafe"


def test_conditions_of_a_folder_of_folders_are_those_beside_each_recording(tmp_path: Path) -> None:
    sample, root = make_sample("mcap_ros2", tmp_path), tmp_path / "set"
    for folder in ("a", "b"):
        shutil.copytree(sample, root / folder)
    (root / "b" / "conditions.csv").write_text("recording,servo_gain\nwave,0.5\nwafe,2\n")
    found = list(ingest_recordings(root, JOINTS))
    said = {one[0].name: dict(one[0].conditions) for one in found if isinstance(one, tuple)}
    assert said == {"a/wave": {}, "b/wave": {"servo_gain": 0.5}}
    assert [one.name for one in found if isinstance(one, Malformed)] == ["b/wafe"]
    (root / "conditions.csv").write_text("recording,servo_gain\nb/wave,0.7\n")
    with pytest.raises(EdreamError, match="both say something about recording 'b/wave'"):
        list(ingest_recordings(root, JOINTS))


def test_conditions_reach_a_recording_whose_name_has_no_folder(tmp_path: Path) -> None:
    root = make_sample("aloha_hdf5", tmp_path)
    (file,) = root.glob("*.hdf5")
    (root / "soft").mkdir()
    shutil.copy(file, root / "soft" / "again.hdf5")
    (root / "soft" / "conditions.csv").write_text("recording,servo_gain\nagain,0.5\n")
    said = {one.name: dict(one.conditions) for one in read_recordings(root) if isinstance(one, Recording)}
    assert said == {file.stem: {}, "again": {"servo_gain": 0.5}}


WRONG_CONDITIONS = ("name,gain\nwave,1\n", "recording,gain\nwave,x\n", "recording,gain\nwave\n", "recording,gain\nwave,1\nwave,2\n")


@pytest.mark.parametrize("text", WRONG_CONDITIONS)
def test_wrong_conditions_are_refused(tmp_path: Path, text: str) -> None:
    path = make_sample("table", tmp_path)
    (path / "conditions.csv").write_text(text)
    with pytest.raises(EdreamError, match=r"conditions\.csv"):
        list(ingest_recordings(path, JOINTS))


def test_strict_stops_at_the_first_malformed_recording(tmp_path: Path) -> None:
    path = make_sample("table", tmp_path)
    (path / "bad.csv").write_text("time,command_shoulder\n0,0\n")
    assert [type(one).__name__ for one in ingest_recordings(path, JOINTS)] == ["Malformed", "tuple"]
    with pytest.raises(EdreamError, match="'bad' is malformed"):
        list(ingest_recordings(path, JOINTS, strict=True))


def test_nothing_selected_says_what_exists(tmp_path: Path) -> None:
    with pytest.raises(EdreamError, match="What exists: wave"):
        list(ingest_recordings(make_sample("table", tmp_path), JOINTS, mapping=MappingConfig(select=("x*",))))


def test_what_no_format_recognises_lists_what_each_looks_for(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("hello")
    with pytest.raises(EdreamError, match=r"No format recognises .*lerobot_v3: .*rlds: "):
        list(read_recordings(tmp_path))
    (tmp_path / "big.mcap").write_text("version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 1\n")
    with pytest.raises(EdreamError, match="Git LFS pointer"):
        list(read_recordings(tmp_path))


HOSTILE_PATHS = ("../../{chunk_index}.parquet", "/etc/{chunk_index}", "{chunk_index:99999999d}", "{chunk_index.__class__}")


@pytest.mark.parametrize("template", HOSTILE_PATHS)
def test_a_data_path_cannot_lead_out_or_run_wild(tmp_path: Path, template: str) -> None:
    path = make_sample("lerobot_v3", tmp_path)
    info = json.loads((path / "meta/info.json").read_text())
    (path / "meta/info.json").write_text(json.dumps(info | {"data_path": template}))
    with pytest.raises(EdreamError, match=r"lies outside|path template"):
        list(read_recordings(path))


@pytest.mark.parametrize("link", [h5py.ExternalLink("other.hdf5", "/x"), h5py.SoftLink("/action")])
def test_links_in_hdf5_files_are_not_followed(tmp_path: Path, link: object) -> None:
    path = make_sample("aloha_hdf5", tmp_path)
    with h5py.File(path / "episode_0.hdf5", "a") as file:
        del file["observations/qpos"]
        file["observations/qpos"] = link
    (found,) = read_recordings(path)
    assert isinstance(found, Malformed) and "links are not followed" in found.reason


def test_a_huge_declared_array_is_refused_before_it_is_made(tmp_path: Path) -> None:
    path = make_sample("aloha_hdf5", tmp_path)
    with h5py.File(path / "episode_0.hdf5", "a") as file:
        del file["action"]
        file.create_dataset("action", (10**12, 14), "f4", chunks=(1024, 14))
    (found,) = read_recordings(path)
    assert isinstance(found, Malformed) and "at most" in found.reason


def test_aloha_needs_a_rate_and_swaps_colours_when_told(tmp_path: Path) -> None:
    path = make_sample("aloha_hdf5", tmp_path)
    with h5py.File(path / "episode_0.hdf5", "a") as file:
        del file["timestamps"]
    with pytest.raises(EdreamError, match=r"ingest\.fps"):
        list(read_recordings(path))
    rgb, bgr = (next(read_recordings(path, ReadOptions(fps=50.0, colour=colour))) for colour in ("rgb", "bgr"))
    assert not isinstance(rgb, Malformed) and not isinstance(bgr, Malformed)
    first, second = (next(iter(one.videos["cam_high"].frames())) for one in (rgb, bgr))
    np.testing.assert_array_equal(first, second[:, :, ::-1])


def test_an_aloha_file_that_has_a_clock_keeps_it_and_the_rate_is_named_as_left_alone(tmp_path: Path) -> None:
    path = make_sample("aloha_hdf5", tmp_path)
    with h5py.File(path / "episode_0.hdf5", "a") as file:
        times = file["timestamps"][()] + np.random.default_rng(0).uniform(0.0, 1e-3, file["timestamps"].shape)
        file["timestamps"][...] = times
    plain, rated = (next(read_recordings(path, options)) for options in (ReadOptions(), ReadOptions(fps=10.0)))
    assert not isinstance(plain, Malformed) and not isinstance(rated, Malformed)
    np.testing.assert_array_equal(rated.times, plain.times)
    assert np.ptp(np.diff(rated.times)) > 1e-4
    said = " ".join(find(map_recording(rated, ("lift", "turn"), MappingConfig(by="order"))).sentences())
    assert "ingest.fps=10 (/timestamps say" in said and "left_alone" not in plain.notes


def test_a_mobile_base_is_kept_as_a_signal_and_depth_is_named_as_left_alone(tmp_path: Path) -> None:
    path = make_sample("aloha_hdf5", tmp_path)
    with h5py.File(path / "episode_0.hdf5", "a") as file:
        base = np.random.default_rng(0).normal(size=(len(file["action"]), 2)).astype(np.float32)
        file["base_action"] = base
        file["observations/images_depth/cam_high"] = np.zeros((len(base), 4, 6), np.uint16)
    (found,) = read_recordings(path)
    assert not isinstance(found, Malformed)
    episode = map_recording(found, ("lift", "turn"), MappingConfig(by="order"))
    write_episode(episode, tmp_path / "out.mcap")
    again = read_episode(tmp_path / "out.mcap")
    np.testing.assert_array_equal(again.signals["base_action"], base)
    said = " ".join(find(again).sentences())
    assert "base_action (2 numbers a row)" in said and "Left alone: observations/images_depth/cam_high." in said


@pytest.mark.parametrize(("column", "value", "said"), [("timestamp", 0.0, "strictly rising"), ("action", float("nan"), "finite")])
def test_a_falling_clock_or_nan_is_named(tmp_path: Path, column: str, value: float, said: str) -> None:
    path = make_sample("lerobot_v21", tmp_path)
    file = path / "data/chunk-000/episode_000000.parquet"
    table = pq.read_table(file)
    rows = table.column(column).to_pylist()
    rows[5] = [value, value] if isinstance(rows[5], list) else value
    place = table.schema.get_field_index(column)
    pq.write_table(table.set_column(place, column, pa.array(rows, table.schema.field(column).type)), file)
    (found,) = read_recordings(path)
    assert isinstance(found, Malformed) and said in found.reason and "row 5" in found.reason


def test_a_switch_is_held_onto_the_commands(tmp_path: Path) -> None:
    (found,) = read_recordings(make_sample("mcap_ros2", tmp_path))
    assert not isinstance(found, Malformed) and found.enabled is not None
    assert found.enabled.tolist() == [True] * 20 + [False] * 5


def test_a_second_copy_of_an_rlds_episode_is_left_out(tmp_path: Path) -> None:
    path = make_sample("rlds", tmp_path)
    file = next(path.iterdir())
    shutil.copy(file, path / "copy.tfrecord")
    kinds = [type(one).__name__ for one in read_recordings(path, ReadOptions(fps=50.0))]
    assert kinds == ["Recording", "Malformed"]


def test_the_incomplete_g1_set_names_what_is_missing_and_reads_the_rest(shared_data: Path) -> None:
    found = list(read_recordings(shared_data / "g1_lerobot_v21"))
    read = [one for one in found if not isinstance(one, Malformed)]
    assert len(read) == 4 and len(found) == 100
    assert all("is missing" in one.reason for one in found if isinstance(one, Malformed))
    image = next(iter(read[0].videos["cam_high"].frames()))
    assert image.shape == (480, 640, 3) and image.std() > 10


def test_the_so101_set_keeps_its_recorded_clock(shared_data: Path) -> None:
    first = next(read_recordings(shared_data / "so101/dataset"))
    assert not isinstance(first, Malformed)
    assert np.median(np.diff(first.times)) == pytest.approx(0.02006, abs=2e-5)
