"""The index of a folder of episodes: one Parquet file, one row an episode."""

import hashlib
import json
from collections.abc import Container, Iterable
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from edream.core.episode import Episode
from edream.core.errors import EdreamError
from edream.ingest import lerobot
from edream.ingest.border import inside

INDEX = "index.parquet"
SCHEMA = pa.schema(
    [
        ("name", pa.string()),
        ("file", pa.string()),
        ("length", pa.int64()),
        ("duration", pa.float64()),
        ("fps", pa.float64()),
        ("joints", pa.list_(pa.string())),
        ("cameras", pa.list_(pa.string())),
        ("conditions", pa.string()),
        ("notes", pa.string()),
        ("sha256", pa.string()),
    ]
)


@dataclass(frozen=True)
class IndexRow:
    """One episode of a folder.

    Attributes:
        name: the episode.
        file: its file, relative to the index.
        length: number of measurements; `duration` from first to last [s]; `fps` their median rate [Hz].
        joints, cameras: what it holds.
        conditions, notes: as in the episode.
        sha256: of the file.
    """

    name: str
    file: str
    length: int
    duration: float
    fps: float
    joints: tuple[str, ...]
    cameras: tuple[str, ...]
    conditions: dict[str, float] = field(default_factory=dict)
    notes: dict[str, str] = field(default_factory=dict)
    sha256: str = ""


def index_row(episode: Episode, file: Path) -> IndexRow:
    """The row of an episode that was written to `file`."""
    with file.open("rb") as stream:
        digest = hashlib.file_digest(stream, "sha256").hexdigest()
    rate = 1.0 / float(np.median(np.diff(episode.times)))
    conditions, notes = dict(episode.conditions), dict(episode.notes)
    return IndexRow(
        episode.name,
        file.name,
        len(episode.times),
        episode.duration,
        rate,
        episode.joints,
        tuple(episode.videos),
        conditions,
        notes,
        digest,
    )


def file_name(name: str, taken: Container[str] = ()) -> str:
    """A safe file name for an episode, unlike those taken: letters, digits, dot, dash and underscore only."""
    plain = "".join(letter if (letter.isalnum() and letter.isascii()) or letter in "._-" else "_" for letter in name).lstrip(".")[
        :150
    ]
    candidate, number = f"{plain or 'episode'}.mcap", 2
    while candidate in taken:
        candidate, number = f"{plain or 'episode'}-{number}.mcap", number + 1
    return candidate


def index_table(rows: Iterable[IndexRow]) -> pa.Table:
    """The index as a table."""
    table = [vars(row) | {"conditions": _text(row.conditions), "notes": _text(row.notes)} for row in rows]
    return pa.Table.from_pylist(table, schema=SCHEMA)


def write_index(rows: Iterable[IndexRow], folder: Path) -> Path:
    """Write the index of a folder of episode files; the same bytes for the same rows."""
    file = folder / INDEX
    pq.write_table(index_table(rows), file, compression="zstd", version="2.6")
    return file


def read_index(folder: Path) -> list[IndexRow]:
    """The rows of a folder's index, in its order.

    Raises:
        EdreamError: there is no index, it is damaged, or it names a file outside the folder.
    """
    file = folder / INDEX
    if not file.is_file():
        raise EdreamError(f"There is no {INDEX} in {folder}; run 'edream ingest' first.")
    rows = []
    for raw in lerobot.rows_of(lerobot.open_parquet(file), file, SCHEMA.names):
        try:
            conditions = {str(key): float(value) for key, value in json.loads(raw["conditions"]).items()}
            notes = {str(key): str(value) for key, value in json.loads(raw["notes"]).items()}
            names = {key: tuple(str(one) for one in raw[key]) for key in ("joints", "cameras")}
            fields: dict[str, Any] = {**raw, **names, "conditions": conditions, "notes": notes}
            row = IndexRow(**fields)
        except (TypeError, ValueError, AttributeError, RecursionError) as error:
            raise EdreamError(f"{file} is damaged: row {len(rows)} is unreadable ({error}).") from error
        if PurePosixPath(row.file).name != row.file:
            raise EdreamError(f"{file} names {row.file!r}; expected a file beside the index.")
        inside(folder, row.file, str(file))
        rows.append(row)
    return rows


def _text(values: dict[str, float] | dict[str, str]) -> str:
    return json.dumps(values, sort_keys=True)
