"""`conditions.csv`: numbers that are known about each recording, next to the recordings."""

import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from edream.core.errors import EdreamError
from edream.ingest.border import read_text

FILE = "conditions.csv"


@dataclass(frozen=True)
class Noted:
    """What a `conditions.csv` says about one recording.

    Attributes:
        file: where it stands.
        names: what the recording may be called: with the folder of the file before it, or without where that is unique.
        numbers: condition -> number.
    """

    file: Path
    names: tuple[str, ...]
    numbers: Mapping[str, float]


def noted(path: Path) -> list[Noted]:
    """What every `conditions.csv` in the folder `path` or below says, or the one beside the file `path`.

    Raises:
        EdreamError: a file is wrong; see `read_conditions`.
    """
    root = path if path.is_dir() else path.parent
    found = sorted(root.rglob(FILE)) if path.is_dir() else [root / FILE]
    out = []
    for file in (file for file in found if file.is_file()):
        folder = file.parent.relative_to(root).as_posix()
        for name, numbers in read_conditions(file).items():
            out.append(Noted(file, (name,) if folder == "." else (f"{folder}/{name}", name), numbers))
    return out


def about(name: str, known: Sequence[Noted]) -> Noted | None:
    """What is noted about the recording of that name, if anything.

    Raises:
        EdreamError: two files say something about it.
    """
    exact = [one for one in known if one.names[0] == name]
    found = exact or [one for one in known if name in one.names]
    if len(found) > 1:
        files = " and ".join(str(one.file) for one in found)
        raise EdreamError(f"{files} both say something about recording {name!r}; expected one.")
    return found[0] if found else None


def read_conditions(file: Path) -> dict[str, dict[str, float]]:
    """Recording name -> condition -> number.

    The first column is `recording`; every other column is one condition; an empty cell means not known.

    Raises:
        EdreamError: the header or a number is wrong, or a recording stands twice.
    """
    try:
        rows = list(csv.reader(io.StringIO(read_text(file)), strict=True))
    except csv.Error as error:
        raise EdreamError(f"{file} is no CSV file: {error}.") from error
    rows = [row for row in rows if any(cell.strip() for cell in row)]
    names = [cell.strip() for cell in rows[0]] if rows else []
    if not names or names[0] != "recording" or len(set(names)) != len(names) or not all(names):
        raise EdreamError(
            f"{file} begins with the columns {', '.join(names) or 'none'}; expected 'recording' first, then one name a condition."
        )
    table: dict[str, dict[str, float]] = {}
    for line, row in enumerate(rows[1:], start=2):
        if len(row) != len(names):
            raise EdreamError(f"{file}, row {line}: it has {len(row)} cells; expected {len(names)}.")
        recording = row[0].strip()
        if recording in table:
            raise EdreamError(f"{file}, row {line}: recording {recording!r} stands twice.")
        cells = zip(names[1:], row[1:], strict=True)
        table[recording] = {name: _number(file, line, name, cell) for name, cell in cells if cell.strip()}
    return table


def _number(file: Path, line: int, name: str, cell: str) -> float:
    try:
        number = float(cell)
    except ValueError as error:
        raise EdreamError(f"{file}, row {line}: {name} is {cell!r}; expected a number.") from error
    if not math.isfinite(number):
        raise EdreamError(f"{file}, row {line}: {name} is {cell!r}; expected a finite number.")
    return number


def write_conditions(table: Mapping[str, Mapping[str, float]], folder: Path) -> None:
    """Write `conditions.csv` into a folder; nothing where no recording has any."""
    names = list(dict.fromkeys(name for row in table.values() for name in row))
    if not names:
        return
    with (folder / FILE).open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["recording", *names])
        for recording, row in table.items():
            writer.writerow([recording, *(repr(float(row[name])) if name in row else "" for name in names)])
