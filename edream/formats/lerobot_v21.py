"""LeRobotDataset v2.0 and v2.1: one Parquet file and one video file an episode."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pyarrow as pa

from edream.core.episode import Recording, Video
from edream.core.errors import EdreamError
from edream.core.format import Format, Malformed, ReadOptions
from edream.ingest import lerobot
from edream.ingest.border import MAX_ROWS, fill_template, finished, inside, one_line, read_text

DATA_PATH = "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet"
DEFAULT_CHUNK = 1000


class LeRobotV21(Format):
    """Commands in `action`, measurements in `observation.state`, on the recorded `timestamp` clock.

    Every episode that `meta/episodes.jsonl` lists is looked for; those whose files are not there are named.
    Source: huggingface/lerobot at codebase version v2.1.
    """

    name = "lerobot_v21"
    summary = "LeRobotDataset v2.x: a folder with meta/info.json whose codebase_version is v2"

    def recognise(self, path: Path) -> str | None:
        version = lerobot.codebase_version(path)
        return f"its info.json says codebase_version {version}" if version and version.startswith("v2") else None

    def recordings(self, path: Path, options: ReadOptions) -> Iterator[Recording | Malformed]:
        info = lerobot.read_info(path)
        for row in _episodes(info):
            name = lerobot.episode_name(row["episode_index"])
            try:
                yield _recording(info, name, row, options)
            except EdreamError as error:
                yield Malformed(name, one_line(error))


def _episodes(info: lerobot.Info) -> list[dict[str, Any]]:
    file = info.root / "meta" / "episodes.jsonl"
    rows = []
    for number, line in enumerate(read_text(file).splitlines(), start=1):
        if not line.strip():
            continue
        try:
            row = json.loads(line)
        except (json.JSONDecodeError, RecursionError) as error:
            raise EdreamError(f"{file}, line {number}: it is not JSON: {one_line(error)}.") from error
        index = row.get("episode_index") if isinstance(row, dict) else None
        length = row.get("length") if isinstance(row, dict) else None
        if type(index) is not int or type(length) is not int or index < 0 or not 0 <= length <= MAX_ROWS:
            raise EdreamError(
                f"{file}, line {number}: episode_index {index!r} and length {length!r} must be whole numbers from 0 on."
            )
        rows.append(row)
    if len({row["episode_index"] for row in rows}) != len(rows):
        raise EdreamError(f"{file} lists an episode twice; expected each episode_index once.")
    return sorted(rows, key=lambda row: row["episode_index"])


def _recording(info: lerobot.Info, name: str, row: dict[str, Any], options: ReadOptions) -> Recording | Malformed:
    index, named_by = row["episode_index"], str(info.root / "meta/info.json")
    size = info.raw.get("chunks_size", DEFAULT_CHUNK)
    chunk = index // size if type(size) is int and size > 0 else 0
    place = {"episode_chunk": chunk, "episode_index": index}
    file = inside(info.root, fill_template(info.raw.get("data_path") or DATA_PATH, place, named_by), named_by)
    if not file.is_file():
        raise EdreamError(f"File {file} is missing, though meta/episodes.jsonl lists this episode.")
    rows = lerobot.open_parquet(file)
    if rows.metadata.num_rows != row["length"]:
        raise EdreamError(f"{file} has {rows.metadata.num_rows} rows; meta/episodes.jsonl says {row['length']}.")
    parts = list(lerobot.batches(rows, file, lerobot.wanted_columns(info)))
    if not parts:
        raise EdreamError(f"{file} has no rows.")
    tasks = row.get("tasks")
    task = "; ".join(str(one) for one in tasks) if isinstance(tasks, list) else ""
    recording = finished(lerobot.to_recording(info, name, pa.Table.from_batches(parts), {}, task), options)
    if isinstance(recording, Malformed):
        return recording
    videos: dict[str, Video] = lerobot.image_videos(info, file, index, recording.times)
    for key in info.cameras("video"):
        video = inside(info.root, fill_template(info.raw.get("video_path"), {**place, "video_key": key}, named_by), named_by)
        videos[lerobot.camera_name(key)] = lerobot.file_video(video, 0.0, recording.times, info.fps)
    return lerobot.with_videos(recording, videos)


ENTRY = LeRobotV21()
