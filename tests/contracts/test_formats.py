"""What every recording format in the catalog must do."""

from pathlib import Path

import numpy as np
import pytest

from edream import catalog
from edream.core.episode import Recording, Video
from edream.core.errors import EdreamError
from edream.core.format import Format, Malformed, ReadOptions
from edream.ingest.recordings import detect_format, read_recordings
from tests.recordings import SAMPLES, make_sample

FORMATS = [catalog.load("formats", name, Format) for name in catalog.names("formats")]
OPTIONS = ReadOptions(fps=None)


def recording(seed: int, rows: int = 30) -> Recording:
    rng = np.random.default_rng(seed)
    times = np.arange(rows) * np.float32(0.02).astype(float)
    times = times.astype(np.float32).astype(float)
    numbers = rng.normal(size=(4, rows, 2)).astype(np.float32).astype(float)
    images = rng.integers(0, 255, (rows, 16, 20, 3), dtype=np.uint8)
    video = Video(times, 16, 20, lambda: iter(images))
    names = ("shoulder", "elbow")
    return Recording(
        f"episode_{seed:06d}",
        times,
        names,
        numbers[0],
        times,
        names,
        numbers[1],
        numbers[2],
        numbers[3],
        None,
        {"front": video},
        {"gain": 2.0 + seed},
    )


def writable(entry: Format) -> bool:
    return type(entry).write is not Format.write


@pytest.mark.parametrize("entry", FORMATS, ids=lambda entry: entry.name)
def test_a_format_recognises_its_own_sample_and_no_other_format_does(entry: Format, tmp_path: Path) -> None:
    path = make_sample(entry.name, tmp_path)
    assert {other.name for other in FORMATS if other.recognise(path)} == {entry.name}
    assert detect_format(path).name == entry.name


@pytest.mark.parametrize("entry", FORMATS, ids=lambda entry: entry.name)
def test_recordings_have_rising_clocks_in_seconds_and_finite_positions(entry: Format, tmp_path: Path) -> None:
    options = ReadOptions(fps=50.0) if entry.name == "rlds" else ReadOptions()
    found = list(entry.recordings(make_sample(entry.name, tmp_path), options))
    assert found
    for one in found:
        assert isinstance(one, Recording), one
        assert one.times.dtype == np.float64 and (np.diff(one.times) > 0).all()
        assert np.median(np.diff(one.times)) == pytest.approx(0.02, rel=1e-3)
        assert np.isfinite(one.position).all() and one.position.shape == (len(one.times), 2)
        np.testing.assert_allclose(one.position, SAMPLES.position, atol=1e-6)
        np.testing.assert_allclose(one.command, SAMPLES.command, atol=1e-6)


@pytest.mark.parametrize("entry", FORMATS, ids=lambda entry: entry.name)
def test_two_reads_give_the_same_names_in_the_same_order(entry: Format, tmp_path: Path) -> None:
    options = ReadOptions(fps=50.0) if entry.name == "rlds" else ReadOptions()
    path = make_sample(entry.name, tmp_path)
    assert [one.name for one in entry.recordings(path, options)] == [one.name for one in entry.recordings(path, options)]


@pytest.mark.parametrize("entry", FORMATS, ids=lambda entry: entry.name)
def test_a_command_shift_moves_the_commands_one_row_later(entry: Format, tmp_path: Path) -> None:
    path = make_sample(entry.name, tmp_path)
    fps = 50.0 if entry.name == "rlds" else None
    plain, moved = (next(iter(entry.recordings(path, ReadOptions(fps=fps, command_shift=shift)))) for shift in (0, 1))
    assert isinstance(plain, Recording) and isinstance(moved, Recording)
    np.testing.assert_array_equal(moved.command, plain.command[:-1])
    np.testing.assert_array_equal(moved.command_times, plain.command_times[1:])


@pytest.mark.parametrize("entry", [entry for entry in FORMATS if writable(entry)], ids=lambda entry: entry.name)
def test_what_is_written_reads_back_the_same(entry: Format, tmp_path: Path) -> None:
    made = [recording(0), recording(1)]
    entry.write(iter(made), tmp_path / "set")
    for before, after in zip(made, read_recordings(tmp_path / "set"), strict=True):
        assert isinstance(after, Recording), after
        assert after.channels == before.channels and after.command_channels == before.command_channels
        for what in ("times", "position", "command_times", "command", "velocity", "effort"):
            np.testing.assert_array_equal(getattr(after, what), getattr(before, what), err_msg=what)
        assert dict(after.conditions) == dict(before.conditions)
        for first, second in zip(before.videos["front"].frames(), after.videos["front"].frames(), strict=True):
            np.testing.assert_array_equal(first, second)


@pytest.mark.parametrize("entry", [entry for entry in FORMATS if writable(entry)], ids=lambda entry: entry.name)
def test_writing_over_something_is_refused(entry: Format, tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("precious")
    with pytest.raises(EdreamError, match="exists already"):
        entry.write([recording(0)], tmp_path)


@pytest.mark.parametrize("entry", [entry for entry in FORMATS if not writable(entry)], ids=lambda entry: entry.name)
def test_a_read_only_format_says_so(entry: Format, tmp_path: Path) -> None:
    with pytest.raises(EdreamError, match="read only"):
        entry.write([recording(0)], tmp_path / "set")


@pytest.mark.parametrize("entry", FORMATS, ids=lambda entry: entry.name)
def test_a_truncated_file_is_named(entry: Format, tmp_path: Path) -> None:
    options = ReadOptions(fps=50.0) if entry.name == "rlds" else ReadOptions()
    path = make_sample(entry.name, tmp_path)
    victim = max(
        (file for file in path.rglob("*") if file.is_file() and "meta" not in file.parts), key=lambda file: file.stat().st_size
    )
    victim.write_bytes(victim.read_bytes()[: victim.stat().st_size // 2])
    found = list(entry.recordings(path, options))
    assert any(isinstance(one, Malformed) for one in found)
    assert all(str(victim.name) in one.reason or "rows" in one.reason for one in found if isinstance(one, Malformed))
