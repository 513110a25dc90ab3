"""What LeRobotDataset v2.1 and v3.0 share: `info.json`, names of channels, and rows of Parquet as arrays."""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from edream.core.episode import Recording, Video
from edream.core.errors import EdreamError
from edream.ingest.border import LFS_MARK, MAX_CHANNELS, MAX_ROWS, check_file, head, one_line, read_text
from edream.ingest.video import EncodedFrames, VideoSegment, image_size, read_header

STATE, COMMAND = "observation.state", "action"
OPTIONAL = {"velocity": "observation.velocity", "effort": "observation.effort"}
MAX_GROUP_BYTES = 4 * 2**30
BATCH_ROWS = 65_536
NESTED = 8


@dataclass(frozen=True)
class Info:
    """`meta/info.json`, checked.

    Attributes:
        root: folder of the data set.
        version: its `codebase_version`, such as "v3.0".
        fps: nominal frame rate [Hz].
        features: feature name -> its declaration.
        raw: the whole file.
    """

    root: Path
    version: str
    fps: float
    features: Mapping[str, Mapping[str, Any]]
    raw: Mapping[str, Any]

    def cameras(self, dtype: str) -> tuple[str, ...]:
        """Keys of the cameras stored as "video" or as "image"."""
        return tuple(key for key, feature in self.features.items() if feature.get("dtype") == dtype)

    def names(self, key: str) -> tuple[str, ...]:
        """Names of a feature's columns; empty where it names none.

        Data sets in the wild nest them in lists and in mappings (`{"motors": [...]}`).
        """
        return tuple(_flat_names(self.features[key].get("names"), 0))

    def width(self, key: str) -> int:
        """Number of columns that a feature declares."""
        shape = self.features[key].get("shape")
        numbers = isinstance(shape, list | tuple) and all(isinstance(n, int) and 0 < n <= MAX_CHANNELS for n in shape)
        if not numbers or not shape or int(np.prod(shape)) > MAX_CHANNELS:
            raise EdreamError(
                f"{self.root / 'meta/info.json'}: feature {key!r} has shape {shape!r}; expected up to {MAX_CHANNELS} numbers a row."
            )
        return int(np.prod(shape))


def find_info(path: Path) -> Path | None:
    """The `info.json` of the data set at `path` (its folder, its `meta` folder or the file itself)."""
    for candidate in (path / "meta" / "info.json", path / "info.json", path):
        if head(candidate, 1) and candidate.suffix == ".json":
            return candidate
    return None


def codebase_version(path: Path) -> str | None:
    """The `codebase_version` that `path` declares, or None where it is no LeRobot data set."""
    file = find_info(path)
    if file is None:
        return None
    if head(file).startswith(LFS_MARK):
        return None
    try:
        raw = json.loads(read_text(file))
    except (EdreamError, json.JSONDecodeError, RecursionError):
        return None
    version = raw.get("codebase_version") if isinstance(raw, dict) else None
    return version if isinstance(version, str) else None


def read_info(path: Path) -> Info:
    """Read and check `meta/info.json`.

    Raises:
        EdreamError: it is missing, is not JSON, or lacks what reading needs.
    """
    file = find_info(path)
    if file is None:
        raise EdreamError(f"There is no meta/info.json in {path}; expected a LeRobot data set.")
    try:
        raw = json.loads(read_text(file))
    except (json.JSONDecodeError, RecursionError) as error:
        raise EdreamError(f"{file} is not JSON: {one_line(error)}.") from error
    if not isinstance(raw, dict):
        raise EdreamError(f"{file} holds a {type(raw).__name__}; expected an object.")
    features, fps = raw.get("features"), raw.get("fps")
    if not isinstance(features, dict) or not all(isinstance(feature, dict) for feature in features.values()):
        raise EdreamError(f"{file} has no mapping 'features' of objects; it is no usable LeRobot data set.")
    if isinstance(fps, bool) or not isinstance(fps, int | float) or not 0 < fps < 1e6:
        raise EdreamError(f"{file} has fps {fps!r}; expected a number above 0 [Hz].")
    for key in (STATE, COMMAND):
        if key not in features:
            raise EdreamError(f"{file} has no feature {key!r}; it lists {', '.join(sorted(features)) or 'none'}.")
    root = file.parent.parent if file.parent.name == "meta" else file.parent
    return Info(root, str(raw.get("codebase_version")), float(fps), features, raw)


def _flat_names(names: Any, depth: int) -> Iterator[str]:
    if isinstance(names, dict):
        # {"motors": [...]} nests the names; {"shoulder": 0} maps them to columns
        if all(isinstance(value, int) for value in names.values()):
            yield from (str(key) for key, _ in sorted(names.items(), key=lambda item: item[1]))
            return
        names = list(names.values())
    if isinstance(names, list | tuple) and depth < NESTED:
        for name in names:
            yield from _flat_names(name, depth + 1)
    elif isinstance(names, str):
        yield names


def open_parquet(file: Path) -> pq.ParquetFile:
    """Open a Parquet file whose declared sizes are sane.

    Raises:
        EdreamError: see `check_file`; or it is no Parquet file, is truncated, or declares more rows than fit.
    """
    check_file(file)
    try:
        parquet = pq.ParquetFile(file)
    except (pa.ArrowException, OSError, ValueError) as error:
        raise EdreamError(f"{file} is not a whole Parquet file: {one_line(error)}.") from error
    if not 0 <= parquet.metadata.num_rows <= MAX_ROWS * 10:
        raise EdreamError(f"{file} declares {parquet.metadata.num_rows} rows; expected at most {MAX_ROWS * 10}.")
    return parquet


def check_columns(parquet: pq.ParquetFile, file: Path, columns: Sequence[str]) -> None:
    """Refuse a file that lacks a column or declares one too large to hold.

    Raises:
        EdreamError: so.
    """
    present = parquet.schema_arrow.names
    for column in columns:
        if column not in present:
            raise EdreamError(f"{file} has no column {column!r}; it has {', '.join(present)}.")
    # asking a damaged file for the sizes of its columns ends the whole process (an uncaught C++ exception in pyarrow 26)
    for group in range(parquet.metadata.num_row_groups):
        total = parquet.metadata.row_group(group).total_byte_size
        if not 0 <= total <= MAX_GROUP_BYTES:
            raise EdreamError(f"{file} declares {total} bytes in row group {group}; expected at most {MAX_GROUP_BYTES}.")


def batches(parquet: pq.ParquetFile, file: Path, columns: Sequence[str], rows: int = BATCH_ROWS) -> Iterator[pa.RecordBatch]:
    """Rows of a Parquet file, a bounded number at a time.

    Raises:
        EdreamError: a column is missing or the file is damaged.
    """
    check_columns(parquet, file, columns)
    try:
        yield from parquet.iter_batches(batch_size=rows, columns=list(columns), use_threads=False)
    except (pa.ArrowException, OSError, ValueError) as error:
        raise EdreamError(f"{file} is damaged: {one_line(error)}.") from error


def rows_of(parquet: pq.ParquetFile, file: Path, columns: Sequence[str]) -> Iterator[dict[str, Any]]:
    """Rows of a Parquet file of texts and numbers, as mappings.

    Raises:
        EdreamError: see `batches`; or a text is not UTF-8.
    """
    for batch in batches(parquet, file, columns, rows=4096):
        try:
            rows = batch.to_pylist()
        except (UnicodeDecodeError, pa.ArrowException, ValueError, OverflowError) as error:
            raise EdreamError(f"{file} is damaged: {one_line(error)}.") from error
        yield from rows


def matrix(column: pa.Array | pa.ChunkedArray, width: int, what: str) -> np.ndarray:
    """A column of numbers or of lists of numbers as float64, (rows, width); nulls become NaN.

    Raises:
        EdreamError: its rows do not all hold `width` numbers.
    """
    if isinstance(column, pa.ChunkedArray):
        column = column.combine_chunks()
    rows = len(column)
    kind = column.type
    while pa.types.is_list(kind) or pa.types.is_large_list(kind) or pa.types.is_fixed_size_list(kind):
        if column.null_count:
            raise EdreamError(f"{what} has {column.null_count} empty rows; expected {width} numbers in each.")
        lengths = column.value_lengths().to_numpy(zero_copy_only=False) if not pa.types.is_fixed_size_list(kind) else None
        if lengths is not None and len(lengths) and (lengths != lengths[0]).any():
            raise EdreamError(f"{what} has rows of {lengths.min()} to {lengths.max()} numbers; expected {width} in each.")
        column = column.flatten()
        kind = column.type
    if not (pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_boolean(kind)):
        raise EdreamError(f"{what} holds {kind}; expected numbers.")
    flat = column.cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False)  # a broken file's huge integers may round
    if len(flat) != rows * width:
        raise EdreamError(f"{what} has {len(flat)} numbers in {rows} rows; expected {width} a row.")
    return flat.reshape(rows, width)


def wanted_columns(info: Info) -> tuple[str, ...]:
    """Columns of numbers that a recording is made of."""
    present = [key for key in OPTIONAL.values() if key in info.features]
    return (STATE, COMMAND, *present, "timestamp", "episode_index")


def to_recording(info: Info, name: str, table: pa.Table, videos: Mapping[str, Video], task: str) -> Recording:
    """One episode's rows as a recording, on the clock of its `timestamp` column.

    Raises:
        EdreamError: a column does not hold what `info.json` declares.
    """

    def read(key: str) -> np.ndarray:
        return matrix(table.column(key), info.width(key), f"{name}: column {key!r}")

    times = matrix(table.column("timestamp"), 1, f"{name}: column 'timestamp'")[:, 0]
    optional = {field: read(key) for field, key in OPTIONAL.items() if key in info.features}
    same = {field: array for field, array in optional.items() if info.width(OPTIONAL[field]) == info.width(STATE)}
    robot = info.raw.get("robot_type")
    notes = {"task": task, "robot_type": robot if isinstance(robot, str) else ""}
    return Recording(
        name=name,
        times=times,
        channels=info.names(STATE),
        position=read(STATE),
        command_times=times,
        command_channels=info.names(COMMAND),
        command=read(COMMAND),
        velocity=same.get("velocity"),
        effort=same.get("effort"),
        videos=videos,
        notes={key: value for key, value in notes.items() if value},
    )


def episode_name(index: int) -> str:
    """The name of episode `index`, the same in every version of the format."""
    return f"episode_{index:06d}"


@dataclass(frozen=True)
class ParquetImages:
    """Encoded images of one episode inside a data file (`dtype: "image"`).

    Attributes:
        file: the Parquet file.
        key: its image column.
        episode: value of `episode_index` in the rows wanted.
    """

    file: Path
    key: str
    episode: int

    def __call__(self) -> Iterator[bytes]:
        parquet = open_parquet(self.file)
        for batch in batches(parquet, self.file, ("episode_index", self.key), rows=64):
            rows = np.flatnonzero(batch.column("episode_index").to_numpy(zero_copy_only=False) == self.episode)
            for row in rows:
                try:
                    value = batch.column(self.key)[int(row)].as_py()
                except UnicodeDecodeError as error:
                    raise EdreamError(f"{self.file} is damaged: an image's name in column {self.key!r} is not text.") from error
                data = value.get("bytes") if isinstance(value, dict) else value
                if not isinstance(data, bytes):
                    raise EdreamError(f"{self.file}: column {self.key!r} holds no image bytes in episode {self.episode}.")
                yield data


def image_videos(info: Info, file: Path, episode: int, times: np.ndarray) -> dict[str, Video]:
    """Cameras stored as images inside the Parquet file.

    Raises:
        EdreamError: the first image of a camera is missing or unreadable.
    """
    videos = {}
    for key in info.cameras("image"):
        images = ParquetImages(file, key, episode)
        first = next(images(), None)
        if first is None:
            raise EdreamError(f"{file}: camera {key!r} has no image in episode {episode}.")
        what = f"{file.name}, camera {key!r}, {episode_name(episode)}"
        height, width = image_size(first, what)
        videos[camera_name(key)] = Video(times, height, width, EncodedFrames(images, what))
    return videos


def file_video(file: Path, start: float, times: np.ndarray, fps: float) -> Video:
    """Frames of one episode in a video file, checked against the file's length.

    Raises:
        EdreamError: it is missing, damaged or too short.
    """
    header = read_header(file)
    needed = start + (len(times) - 1.5) / fps
    if header.duration is not None and header.duration < needed:
        raise EdreamError(f"Video {file} lasts {header.duration:.3f} s; this episode needs it up to {needed:.3f} s.")
    return Video(times, header.height, header.width, VideoSegment(file, start, len(times), fps))


def camera_name(key: str) -> str:
    """A camera's short name: the key without `observation.images.`."""
    return key.removeprefix("observation.images.").removeprefix("observation.image.")


def with_videos(recording: Recording, videos: Mapping[str, Video]) -> Recording:
    """The same recording with its cameras."""
    return replace(recording, videos=videos)
