"""LeRobotDataset v3.0 written from recordings, one episode at a time."""

import json
from collections.abc import Iterable, Mapping
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from jaxtyping import Float

from edream.core.episode import Episode, Recording, Video
from edream.core.errors import EdreamError, unknown_name
from edream.ingest.conditions import write_conditions
from edream.ingest.lerobot import COMMAND, STATE, episode_name
from edream.ingest.lerobot_stats import Stats, image_sample
from edream.ingest.rows import held_commands, new_folder
from edream.ingest.video import EncodedFrames, encode_image

FILE_BYTES = 100 * 2**20
VIDEO_CLOCK = 90_000
IMAGE = pa.struct([("bytes", pa.binary()), ("path", pa.string())])
INDICES = {"frame_index": "int64", "episode_index": "int64", "index": "int64", "task_index": "int64"}


def export_lerobot(episodes: Iterable[Episode], path: Path, images: str = "image") -> None:
    """Write episodes as a LeRobotDataset v3.0.

    Args:
        episodes: in any number, one held at a time; all of one robot.
        path: the new folder.
        images: "image" (PNG inside the Parquet files, lossless) or "video" (h264, smaller).

    Raises:
        EdreamError: `path` is in use, or the episodes differ in joints or cameras.
    """
    write_dataset((_as_recording(episode) for episode in episodes), path, images)


def _as_recording(episode: Episode) -> Recording:
    return Recording(
        name=episode.name,
        times=episode.times,
        channels=episode.joints,
        position=episode.position,
        command_times=episode.command_times,
        command_channels=episode.joints,
        command=episode.command,
        velocity=episode.velocity,
        effort=episode.effort,
        videos=episode.videos,
        conditions=episode.conditions,
        notes=episode.notes,
    )


def write_dataset(recordings: Iterable[Recording], path: Path, images: str = "image") -> None:
    """Write recordings as a LeRobotDataset v3.0, on their recorded clocks; see `export_lerobot`.

    Commands are those in force at each measurement. Known conditions go to `conditions.csv`.

    Raises:
        EdreamError: see `export_lerobot`.
    """
    if images not in ("image", "video"):
        raise unknown_name("way to export images", images, ("image", "video"))
    new_folder(path)
    writer: _Writer | None = None
    for recording in recordings:
        writer = writer or _Writer(recording, path, images)
        writer.add(recording)
    if writer is None:
        raise EdreamError(f"There is no episode to write to {path}.")
    writer.finish()


class _Writer:
    """The state of one data set being written."""

    def __init__(self, first: Recording, root: Path, images: str) -> None:
        self.root, self.images = root, images
        self.features = _features(first, images)
        self.fps = max(1, round(1.0 / float(np.median(np.diff(first.times)))))
        self.tasks: dict[str, int] = {}
        self.rows: list[dict[str, Any]] = []
        self.conditions: dict[str, Mapping[str, float]] = {}
        self.stats = Stats()
        self.frames = self.file = self.bytes = 0
        self.open: pq.ParquetWriter | None = None
        self.robot = first.notes.get("robot_type") or first.notes.get("robot") or "unknown"

    def add(self, recording: Recording) -> None:
        found = _features(recording, self.images)
        if found != self.features:
            odd = sorted(key for key in found.keys() | self.features.keys() if found.get(key) != self.features.get(key))
            raise EdreamError(
                f"Recording {recording.name!r} differs from the first in {', '.join(odd)}; one LeRobot data set holds "
                "one robot with one set of cameras."
            )
        index, length = len(self.rows), len(recording.times)
        task = recording.notes.get("task") or recording.name
        self.tasks.setdefault(task, len(self.tasks))
        stats = Stats()
        row: dict[str, Any] = {"episode_index": index, "tasks": [task], "length": length}
        row |= {
            "data/chunk_index": 0,
            "data/file_index": self.file,
            "dataset_from_index": self.frames,
            "dataset_to_index": self.frames + length,
        }
        numbers = _numbers(recording) | {
            "frame_index": np.arange(length),
            "episode_index": np.full(length, index),
            "index": np.arange(self.frames, self.frames + length),
            "task_index": np.full(length, self.tasks[task]),
        }
        for key, array in numbers.items():
            stats.add(key, array.reshape(length, -1).astype(np.float64))
        table = pa.table({key: _column(array, self.features[key]["dtype"]) for key, array in numbers.items()})
        for camera, video in recording.videos.items():
            key = f"observation.images.{camera}"
            stats.add_images(key, image_sample(video))
            if self.images == "video":
                self._write_video(key, recording, video)
                row |= {f"videos/{key}/chunk_index": 0, f"videos/{key}/file_index": index}
                row |= {
                    f"videos/{key}/from_timestamp": 0.0,
                    f"videos/{key}/to_timestamp": float(recording.times[-1] - recording.times[0]) + 1.0 / self.fps,
                }
            else:
                table = table.append_column(key, _image_column(recording, camera, video))
        self._write_table(table)
        self.stats.merge(stats)
        row |= stats.flat() | {"meta/episodes/chunk_index": 0, "meta/episodes/file_index": 0}
        self.rows.append(row)
        self.conditions[episode_name(index)] = recording.conditions
        self.frames += length

    def _write_table(self, table: pa.Table) -> None:
        if self.open is None:
            file = self.root / f"data/chunk-000/file-{self.file:03d}.parquet"
            file.parent.mkdir(parents=True, exist_ok=True)
            self.open = pq.ParquetWriter(file, table.schema)
        self.open.write_table(table)
        self.bytes += table.nbytes
        if self.bytes > FILE_BYTES:
            self.open.close()
            self.open, self.bytes, self.file = None, 0, self.file + 1

    def _write_video(self, key: str, recording: Recording, video: Video) -> None:
        file = self.root / f"videos/{key}/chunk-000/file-{len(self.rows):03d}.mp4"
        file.parent.mkdir(parents=True, exist_ok=True)
        pixels = _pixel_format(video.height, video.width)
        times = np.round((recording.times - recording.times[0]) * VIDEO_CLOCK).astype(int).tolist()
        # one thread: x264 writes other bytes for every number of threads
        with av.open(str(file), "w") as container:
            stream = container.add_stream("libx264", rate=self.fps, options={"threads": "1", "crf": "18", "g": "2", "bf": "0"})
            stream.width, stream.height, stream.pix_fmt = video.width, video.height, pixels
            stream.codec_context.time_base = stream.time_base = Fraction(1, VIDEO_CLOCK)
            for time, image in zip(times, _counted(recording, key, video), strict=True):
                frame = av.VideoFrame.from_ndarray(image, format="rgb24")
                frame.pts, frame.time_base = time, Fraction(1, VIDEO_CLOCK)
                container.mux(stream.encode(frame))
            container.mux(stream.encode())

    def finish(self) -> None:
        if self.open is not None:
            self.open.close()
        for feature in self.features.values():
            if feature["dtype"] == "video":
                feature["info"] = _video_info(self.fps, *feature["shape"][:2])
        meta = self.root / "meta"
        (meta / "episodes/chunk-000").mkdir(parents=True)
        pq.write_table(pa.Table.from_pylist(self.rows), meta / "episodes/chunk-000/file-000.parquet")
        _write_tasks(self.tasks, meta / "tasks.parquet")
        _write_json(self.stats.nested(), meta / "stats.json")
        info = {
            "codebase_version": "v3.0",
            "robot_type": self.robot,
            "total_episodes": len(self.rows),
            "total_frames": self.frames,
            "total_tasks": len(self.tasks),
            "chunks_size": 1000,
            "data_files_size_in_mb": FILE_BYTES // 2**20,
            "video_files_size_in_mb": 200,
            "fps": self.fps,
            "splits": {"train": f"0:{len(self.rows)}"},
            "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
            "video_path": "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
            if self.images == "video"
            else None,
            "features": self.features,
        }
        _write_json(info, meta / "info.json")
        write_conditions(self.conditions, self.root)


def _features(recording: Recording, images: str) -> dict[str, dict[str, Any]]:
    state, command = recording.position.shape[1], recording.command.shape[1]
    names = list(recording.channels) or [f"joint_{i}" for i in range(state)]
    features: dict[str, dict[str, Any]] = {STATE: {"dtype": "float32", "shape": [state], "names": names}}
    for what in ("velocity", "effort"):
        if getattr(recording, what) is not None:
            features[f"observation.{what}"] = {"dtype": "float32", "shape": [state], "names": names}
    action = list(recording.command_channels) or [f"joint_{i}" for i in range(command)]
    features[COMMAND] = {"dtype": "float32", "shape": [command], "names": action}
    for camera, video in recording.videos.items():
        shape = [video.height, video.width, 3]
        features[f"observation.images.{camera}"] = {"dtype": images, "shape": shape, "names": ["height", "width", "channels"]}
    features["timestamp"] = {"dtype": "float32", "shape": [1], "names": None}
    return features | {key: {"dtype": dtype, "shape": [1], "names": None} for key, dtype in INDICES.items()}


def _pixel_format(height: int, width: int) -> str:
    """h264 halves the colour's resolution only where both sides are even."""
    return "yuv420p" if height % 2 == 0 and width % 2 == 0 else "yuv444p"


def _video_info(fps: int, height: int, width: int) -> dict[str, Any]:
    info = {"video.fps": fps, "video.height": height, "video.width": width, "video.channels": 3, "video.codec": "h264"}
    return info | {"video.pix_fmt": _pixel_format(height, width), "video.is_depth_map": False, "has_audio": False}


def _numbers(recording: Recording) -> dict[str, Float[np.ndarray, "T *C"]]:
    numbers = {STATE: recording.position, COMMAND: held_commands(recording)}
    numbers |= {f"observation.{what}": array for what in ("velocity", "effort") if (array := getattr(recording, what)) is not None}
    return numbers | {"timestamp": recording.times - recording.times[0]}


def _column(array: np.ndarray, dtype: str) -> pa.Array:
    kind = {"float32": pa.float32(), "int64": pa.int64()}[dtype]
    flat = pa.array(np.ascontiguousarray(array, dtype=dtype).ravel(), kind)
    return flat if array.ndim == 1 else pa.FixedSizeListArray.from_arrays(flat, array.shape[1])


def _counted(recording: Recording, key: str, video: Video) -> Iterable[np.ndarray]:
    if len(video.times) != len(recording.times):
        raise EdreamError(
            f"Recording {recording.name!r}: camera {key!r} has {len(video.times)} images for {len(recording.times)} "
            "rows; LeRobot needs one each."
        )
    return video.frames()


def _image_column(recording: Recording, camera: str, video: Video) -> pa.Array:
    frames = _counted(recording, camera, video)
    untouched = isinstance(video.frames, EncodedFrames) and not video.frames.swap
    encoded = video.frames.encoded() if untouched else (encode_image(image, "png") for image in frames)  # type: ignore[union-attr]
    rows = [{"bytes": data, "path": f"frame-{row:06d}.png"} for row, data in enumerate(encoded)]
    if len(rows) != len(recording.times):
        raise EdreamError(
            f"Recording {recording.name!r}: camera {camera!r} has {len(rows)} images for {len(recording.times)} rows."
        )
    return pa.array(rows, IMAGE)


def _write_tasks(tasks: Mapping[str, int], file: Path) -> None:
    table = pa.table(
        {"task_index": pa.array(list(tasks.values()), pa.int64()), "__index_level_0__": pa.array(list(tasks), pa.string())}
    )
    # the client reads this with pandas and looks tasks up in the index
    described = {
        "name": None,
        "field_name": "__index_level_0__",
        "pandas_type": "unicode",
        "numpy_type": "object",
        "metadata": None,
    }
    column = {"name": "task_index", "field_name": "task_index", "pandas_type": "int64", "numpy_type": "int64", "metadata": None}
    pandas = {
        "index_columns": ["__index_level_0__"],
        "column_indexes": [],
        "columns": [column, described],
        "pandas_version": "2.0.0",
    }
    pq.write_table(table.replace_schema_metadata({"pandas": json.dumps(pandas)}), file)


def _write_json(value: Mapping[str, Any], file: Path) -> None:
    file.write_text(json.dumps(value, indent=2) + "\n", encoding="utf-8")
