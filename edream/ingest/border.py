"""What every reader checks before it believes a file."""

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from edream.core.episode import Recording
from edream.core.errors import EdreamError
from edream.core.format import Malformed, ReadOptions

LFS_MARK = b"version https://git-lfs"
MAX_TEXT = 64 * 2**20
MAX_ROWS = 20_000_000
MAX_CHANNELS = 4096
MAX_PIXELS = 64 * 2**20


def head(path: Path, size: int = 64) -> bytes:
    """The first bytes of a file, fewer where it is shorter, none where it is no readable file."""
    try:
        if not path.is_file():
            return b""
        with path.open("rb") as file:
            return file.read(size)
    except OSError:
        return b""


def check_file(path: Path, limit: int | None = None) -> Path:
    """The same path, known to be a file with data in it.

    Raises:
        EdreamError: it does not exist, is empty, is a Git LFS pointer or is larger than `limit` [bytes].
    """
    if not path.is_file():
        raise EdreamError(f"File {path} is missing.")
    size = path.stat().st_size
    if size == 0:
        raise EdreamError(f"File {path} is empty (0 bytes).")
    if head(path).startswith(LFS_MARK):
        raise EdreamError(f"{path} is a Git LFS pointer, not the data itself. Run 'git lfs pull' where it came from.")
    if limit is not None and size > limit:
        raise EdreamError(f"File {path} has {size} bytes; expected at most {limit}.")
    return path


def read_text(path: Path) -> str:
    """A text file of bounded size.

    Raises:
        EdreamError: see `check_file`; or it is not UTF-8.
    """
    data = check_file(path, MAX_TEXT).read_bytes()
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise EdreamError(f"File {path} is not text: byte {error.start} is not UTF-8.") from error


def inside(root: Path, relative: str, named_by: str) -> Path:
    """A path that a data set names, known to lie inside the data set's own folder.

    Raises:
        EdreamError: it leads outside, by `..`, an absolute path or a link, or is none that a file can have.
    """
    try:
        target = (root / relative).resolve()
        target.exists()  # where the path is too long, only this says so
    except (OSError, ValueError, RuntimeError) as error:
        what = error.strerror if isinstance(error, OSError) and error.strerror else one_line(error)
        raise EdreamError(f"{named_by} names {relative[:100]!r}, which is no usable path: {what}.") from error
    if not target.is_relative_to(root.resolve()):
        raise EdreamError(f"{named_by} names {relative!r}, which lies outside {root}; it was not opened.")
    return target


def fill_template(template: object, values: Mapping[str, int | str], named_by: str) -> str:
    """Fill `{name}` and `{name:03d}` in a path template that came with the data.

    `str.format` would let the data ask for attributes and for gigabytes of padding.

    Raises:
        EdreamError: a placeholder is unknown or not of that form.
    """

    def one(match: re.Match[str]) -> str:
        name, width = match.group(1), match.group(2)
        if name not in values:
            raise EdreamError(
                f"{named_by} has the path template {template!r} with {{{name}}}; known are {', '.join(sorted(values))}."
            )
        return str(values[name]).zfill(int(width)) if width else str(values[name])

    if not isinstance(template, str):
        raise EdreamError(f"{named_by} has the path template {template!r}; expected text.")
    filled = re.sub(r"\{(\w+)(?::0?(\d{1,2})d)?\}", one, template)
    if "{" in filled or "}" in filled:
        raise EdreamError(f"{named_by} has the path template {template!r}, which is not made of {{name}} and {{name:03d}} alone.")
    return filled


def one_line(error: BaseException) -> str:
    """An exception's text on one line, or its type's name where it has none."""
    text = " ".join(str(error).split())
    return (text[:300] + "...") if len(text) > 300 else (text or type(error).__name__)


def finished(recording: Recording, options: ReadOptions) -> Recording | Malformed:
    """Move the commands by `options.command_shift` rows, then check shapes, clocks and numbers.

    Returns:
        the recording, or why it cannot be used.
    """
    recording = _shifted(recording, options.command_shift)
    problem = _problem(recording)
    return Malformed(recording.name, problem) if problem else recording


def _shifted(recording: Recording, rows: int) -> Recording:
    if rows == 0 or len(recording.command) == 0:
        return recording
    kept = slice(None, -rows) if rows > 0 else slice(-rows, None)
    clock = slice(rows, None) if rows > 0 else slice(None, rows)
    enabled = recording.enabled[clock] if recording.enabled is not None else None
    return replace(recording, command_times=recording.command_times[clock], command=recording.command[kept], enabled=enabled)


def _problem(recording: Recording) -> str | None:
    rows = (
        ("measurement", recording.times, recording.position, recording.channels),
        ("command", recording.command_times, recording.command, recording.command_channels),
    )
    for what, clock, values, channels in rows:
        if what == "command" and not len(clock) and not len(values):
            continue
        if values.ndim != 2 or len(clock) != len(values):
            return f"its {what} array has shape {values.shape} for {len(clock)} times; expected one row a time."
        if channels and len(channels) != values.shape[1]:
            return f"it names {len(channels)} {what} channels but has {values.shape[1]} columns."
        problem = _clock_problem(what, clock) or _number_problem(what, values, channels)
        if problem:
            return problem
    for what in ("velocity", "effort"):
        array = getattr(recording, what)
        if array is not None and array.shape != recording.position.shape:
            return f"its {what} array has shape {array.shape}; expected {recording.position.shape} like the positions."
    return None


def _clock_problem(what: str, clock: np.ndarray) -> str | None:
    if len(clock) < 2:
        return f"it has {len(clock)} {what} rows; expected at least 2."
    if not np.isfinite(clock).all():
        return f"its {what} clock is not a finite number at row {int(np.argmin(np.isfinite(clock)))}."
    steps = np.diff(clock)
    if (steps <= 0).any():
        row = int(np.argmax(steps <= 0)) + 1
        return (
            f"its {what} clock goes from {clock[row - 1]:.6f} s to {clock[row]:.6f} s at row {row} "
            f"({int((steps <= 0).sum())} such steps); expected strictly rising times."
        )
    return None


def _number_problem(what: str, values: np.ndarray, channels: tuple[str, ...]) -> str | None:
    finite = np.isfinite(values)
    if finite.all():
        return None
    row, column = np.argwhere(~finite)[0]
    named = channels[column] if channels else str(column)
    return (
        f"its {what} of channel {named!r} is {values[row, column]} at row {row} ({int((~finite).sum())} such "
        "values); expected finite numbers."
    )
