"""Plain tables, CSV or Parquet: one file a recording, columns named in the configuration."""

import csv
import io
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from edream.core.episode import Recording
from edream.core.errors import EdreamError, unknown_name
from edream.core.format import Format, Malformed, ReadOptions
from edream.ingest import lerobot
from edream.ingest.border import LFS_MARK, MAX_CHANNELS, MAX_ROWS, finished, head, read_text
from edream.ingest.conditions import FILE

PARQUET = b"PAR1"
DELIMITERS = ",;\t"
TIME_NAMES = ("time", "t", "timestamp", "time_s", "seconds")
MAX_FILES = 100_000


class Table(Format):
    """A time column [s], commanded and measured columns, named by `ingest.time`, `ingest.command` and `ingest.position`.

    Without names, the time column is the one called time, t or timestamp, and the rest are told apart by a word in them: command,
    cmd, target, desired, goal or action against position, pos, measured, actual or state.
    """

    name = "table"
    summary = "CSV or Parquet files with a header, a time column and commanded and measured columns"

    def recognise(self, path: Path) -> str | None:
        if lerobot.find_info(path) is not None and path.is_dir():
            return None
        for file in _files(path):
            try:
                names = _header(file)
            except EdreamError:
                continue
            if any(name.strip().lower() in TIME_NAMES for name in names) and len(names) > 1:
                return f"{file.name} is a table with a time column"
        return None

    def recordings(self, path: Path, options: ReadOptions) -> Iterator[Recording | Malformed]:
        files = _files(path)
        stems = [file.stem for file in files]
        for file in files:
            name = file.stem if len(set(stems)) == len(stems) else file.name
            try:
                yield finished(_read(file, name, options), options)
            except EdreamError as error:
                yield Malformed(name, str(error))


def _files(path: Path) -> list[Path]:
    if path.is_file():
        return [path] if _is_table(path) else []
    found = []
    for count, file in enumerate(path.iterdir() if path.is_dir() else ()):
        if count > MAX_FILES:
            raise EdreamError(f"{path} holds more than {MAX_FILES} files; point at the folder of the recordings.")
        if file.is_file() and file.name != FILE and _is_table(file) and file.resolve().is_relative_to(path.resolve()):
            found.append(file)
    return sorted(found)


def _is_table(file: Path) -> bool:
    start = head(file, 4096)
    if start.startswith(PARQUET) or file.suffix == ".parquet":
        return True
    if not start or b"\x00" in start or start.startswith(LFS_MARK):
        return file.suffix == ".csv"
    line = start.split(b"\n", 1)[0]
    return file.suffix in (".csv", ".tsv") or (
        file.suffix in (".txt", "") and line.count(b",") + line.count(b";") + line.count(b"\t") > 0
    )


def _header(file: Path) -> list[str]:
    if head(file, 4) == PARQUET:
        return list(lerobot.open_parquet(file).schema_arrow.names)
    return [name.strip() for name in _rows(file, head(file, 65536).decode("utf-8-sig", "replace").splitlines()[:1])[0]]


def _rows(file: Path, lines: list[str]) -> list[list[str]]:
    if not lines:
        raise EdreamError(f"{file} has no rows; expected a header and numbers.")
    delimiter = max(DELIMITERS, key=lines[0].count)
    try:
        rows = list(csv.reader(io.StringIO("\n".join(lines)), delimiter=delimiter))
    except csv.Error as error:
        raise EdreamError(f"{file} is no CSV file: {error}.") from error
    if not rows or not rows[0]:
        raise EdreamError(f"{file} begins with an empty line; expected a header.")
    return rows


def _read(file: Path, name: str, options: ReadOptions) -> Recording:
    names = _header(file)
    if len(set(names)) != len(names) or len(names) > MAX_CHANNELS:
        raise EdreamError(
            f"{file} has {len(names)} columns, {len(names) - len(set(names))} of them named twice; expected up to "
            f"{MAX_CHANNELS}, each named once."
        )
    time = _time_column(file, names, options)
    command = options.command or _guess(names, time, ("command", "cmd", "target", "desired", "goal", "action", "setpoint"))
    position = options.position or _guess(names, time, ("position", "pos", "measured", "actual", "state"), without=command)
    for what, columns in (("command", command), ("position", position)):
        if not columns:
            raise EdreamError(
                f"{file}: which columns are the {what}s? Name them as ingest.{what}=[COLUMN,...]. What exists: {', '.join(names)}."
            )
        for column in columns:
            if column not in names:
                raise unknown_name(f"column in {file.name}", column, names)
    values = _columns(file, names, [time, *command, *position])
    return Recording(
        name=name,
        times=values[:, 0],
        channels=_plain(position),
        position=values[:, 1 + len(command) :],
        command_times=values[:, 0],
        command_channels=_plain(command),
        command=values[:, 1 : 1 + len(command)],
    )


def _time_column(file: Path, names: list[str], options: ReadOptions) -> str:
    if options.time is not None:
        if options.time not in names:
            raise unknown_name(f"time column in {file.name}", options.time, names)
        return options.time
    found = [name for name in names if name.lower() in TIME_NAMES]
    if len(found) != 1:
        raise EdreamError(f"{file}: which column is the time [s]? Name it as ingest.time=COLUMN. What exists: {', '.join(names)}.")
    return found[0]


def _guess(names: list[str], time: str, words: tuple[str, ...], without: tuple[str, ...] = ()) -> tuple[str, ...]:
    return tuple(name for name in names if name != time and name not in without and any(word in name.lower() for word in words))


def _plain(columns: tuple[str, ...]) -> tuple[str, ...]:
    """Channel names without what only says which of the two they are."""
    marks = (
        "command_",
        "commanded_",
        "cmd_",
        "target_",
        "desired_",
        "goal_",
        "action_",
        "position_",
        "measured_",
        "actual_",
        "state_",
        "pos_",
    )
    ends = (
        "_command",
        "_cmd",
        "_target",
        "_desired",
        "_goal",
        "_action",
        "_position",
        "_measured",
        "_actual",
        "_state",
        "_pos",
        ".pos",
        ".cmd",
    )
    plain = []
    for column in columns:
        for mark in marks:
            column = column.removeprefix(mark) if len(column) > len(mark) else column
        for end in ends:
            column = column.removesuffix(end) if len(column) > len(end) else column
        plain.append(column)
    return tuple(plain) if len(set(plain)) == len(plain) else columns


def _columns(file: Path, names: list[str], wanted: list[str]) -> np.ndarray:
    if head(file, 4) == PARQUET:
        parts = [
            np.column_stack([lerobot.matrix(batch.column(name), 1, f"{file}: column {name!r}")[:, 0] for name in wanted])
            for batch in lerobot.batches(lerobot.open_parquet(file), file, sorted(set(wanted)))
        ]
        if not parts:
            raise EdreamError(f"{file} has no rows.")
        return np.concatenate(parts)
    rows = [row for row in _rows(file, read_text(file).splitlines())[1:] if row]
    if len(rows) > MAX_ROWS:
        raise EdreamError(f"{file} has {len(rows)} rows; expected at most {MAX_ROWS}.")
    index = [names.index(name) for name in wanted]
    table = np.empty((len(rows), len(wanted)))
    for number, row in enumerate(rows):
        if len(row) != len(names):
            raise EdreamError(f"{file}, line {number + 2}: it has {len(row)} cells; expected {len(names)}.")
        try:
            table[number] = [float(row[column]) for column in index]
        except ValueError as error:
            raise EdreamError(f"{file}, line {number + 2}: {one_cell(error)}; expected numbers.") from error
    return table


def one_cell(error: ValueError) -> str:
    """The cell that `float` refused, as its message tells it."""
    return str(error).removeprefix("could not convert string to float: ") + " is no number"


ENTRY = Table()
