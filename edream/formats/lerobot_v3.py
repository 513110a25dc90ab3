"""LeRobotDataset v3.0: many episodes in one Parquet file, many in one video file."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from edream.core.episode import Recording
from edream.core.errors import EdreamError
from edream.core.format import Format, Malformed, ReadOptions
from edream.ingest import lerobot
from edream.ingest.border import fill_template, finished, inside, one_line
from edream.ingest.lerobot_write import write_dataset

DATA_PATH = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"


@dataclass(frozen=True)
class _Listed:
    """One row of `meta/episodes`."""

    index: int
    length: int
    chunk: int
    file: int
    task: str
    row: dict[str, Any]


class LeRobotV3(Format):
    """Commands in `action`, measurements in `observation.state`, on the recorded `timestamp` clock.

    Source: huggingface/lerobot, `lerobot-dataset` 0.4 (codebase version v3.0).
    """

    name = "lerobot_v3"
    summary = "LeRobotDataset v3.x: a folder with meta/info.json whose codebase_version is v3"

    def recognise(self, path: Path) -> str | None:
        version = lerobot.codebase_version(path)
        return f"its info.json says codebase_version {version}" if version and version.startswith("v3") else None

    def recordings(self, path: Path, options: ReadOptions) -> Iterator[Recording | Malformed]:
        info = lerobot.read_info(path)
        by_file: dict[tuple[int, int], list[_Listed]] = {}
        for listed in _episodes(info):
            by_file.setdefault((listed.chunk, listed.file), []).append(listed)
        for (chunk, file), listed in by_file.items():
            template = info.raw.get("data_path") or DATA_PATH
            named_by = str(info.root / "meta/info.json")
            relative = fill_template(template, {"chunk_index": chunk, "file_index": file}, named_by)
            yield from _file_recordings(info, inside(info.root, relative, named_by), listed, options)

    def write(self, recordings: Iterable[Recording], path: Path) -> None:
        write_dataset(recordings, path)


def _episodes(info: lerobot.Info) -> list[_Listed]:
    folder = info.root / "meta" / "episodes"
    files = sorted(folder.glob("**/*.parquet"))
    if not files:
        raise EdreamError(f"There is no Parquet file under {folder}; the data set's list of episodes is missing.")
    listed = []
    for file in files:
        inside(info.root, str(file.relative_to(info.root)), str(folder))
        parquet = lerobot.open_parquet(file)
        columns = [c for c in parquet.schema_arrow.names if not c.startswith("stats/")]
        listed += [_listed(row, file) for row in lerobot.rows_of(parquet, file, columns)]
    twice = {one.index for one in listed}
    if len(twice) != len(listed):
        raise EdreamError(f"{folder} lists an episode twice; expected each episode_index once.")
    return sorted(listed, key=lambda one: (one.chunk, one.file, one.index))


def _listed(row: dict[str, Any], file: Path) -> _Listed:
    def whole(key: str) -> int:
        value = row.get(key)
        if isinstance(value, bool) or not isinstance(value, int) or value < 0:
            raise EdreamError(f"{file}: {key!r} is {value!r}; expected a whole number from 0 on.")
        return value

    tasks = row.get("tasks")
    task = "; ".join(str(task) for task in tasks) if isinstance(tasks, list) else ""
    return _Listed(whole("episode_index"), whole("length"), whole("data/chunk_index"), whole("data/file_index"), task, row)


def _file_recordings(
    info: lerobot.Info, file: Path, listed: list[_Listed], options: ReadOptions
) -> Iterator[Recording | Malformed]:
    waiting = {one.index: one for one in listed}
    reason = f"{file} holds no row of it, though meta/episodes lists it there"
    try:
        for index, table in _grouped(info, file):
            one = waiting.pop(index, None)
            if one is None:
                yield Malformed(
                    lerobot.episode_name(index), f"{file} holds rows of it, but meta/episodes lists it not or elsewhere."
                )
            else:
                yield _recording(info, file, one, table, options)
    except EdreamError as error:
        reason = str(error).rstrip(".")
    for index in waiting:
        yield Malformed(lerobot.episode_name(index), f"{reason}.")


def _grouped(info: lerobot.Info, file: Path) -> Iterator[tuple[int, pa.Table]]:
    """Consecutive rows of one episode each, without holding more than one episode and one batch."""
    parquet = lerobot.open_parquet(file)
    held: list[pa.RecordBatch] = []
    current = -1
    for batch in lerobot.batches(parquet, file, lerobot.wanted_columns(info)):
        index = lerobot.matrix(batch.column("episode_index"), 1, f"{file}: column 'episode_index'")[:, 0]
        edges = np.flatnonzero(np.diff(index)) + 1
        for start, stop in zip([0, *edges], [*edges, len(index)], strict=True):
            if start == stop:
                continue
            if not np.isfinite(index[start]):
                raise EdreamError(f"{file}: 'episode_index' is empty in some rows.")
            if held and index[start] != current:
                yield current, pa.Table.from_batches(held)
                held = []
            current = int(index[start])
            held.append(batch.slice(start, stop - start))
    if held:
        yield current, pa.Table.from_batches(held)


def _recording(info: lerobot.Info, file: Path, one: _Listed, table: pa.Table, options: ReadOptions) -> Recording | Malformed:
    name = lerobot.episode_name(one.index)
    if len(table) != one.length:
        return Malformed(name, f"{file} has {len(table)} rows of it; meta/episodes says {one.length}.")
    try:
        recording = lerobot.to_recording(info, name, table, {}, one.task)
        checked = finished(recording, options)
        if isinstance(checked, Malformed):
            return checked
        videos = lerobot.image_videos(info, file, one.index, recording.times) | _videos(info, one, recording.times)
    except EdreamError as error:
        return Malformed(name, one_line(error))
    return lerobot.with_videos(checked, videos)


def _videos(info: lerobot.Info, one: _Listed, times: np.ndarray) -> dict[str, lerobot.Video]:
    videos = {}
    named_by = str(info.root / "meta/info.json")
    for key in info.cameras("video"):
        start = one.row.get(f"videos/{key}/from_timestamp")
        stored = {part: one.row.get(f"videos/{key}/{part}") for part in ("chunk_index", "file_index")}
        place = {part: value for part, value in stored.items() if isinstance(value, int)}
        if not isinstance(start, int | float) or not np.isfinite(start) or len(place) < 2:
            raise EdreamError(f"meta/episodes does not say where the video of camera {key!r} lies in episode {one.index}.")
        relative = fill_template(info.raw.get("video_path"), {**place, "video_key": key}, named_by)
        file = inside(info.root, relative, named_by)
        videos[lerobot.camera_name(key)] = lerobot.file_video(file, float(start), times, info.fps)
    return videos


ENTRY = LeRobotV3()
