"""From a path to episodes: find the format, read, map, look over, one recording at a time."""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path

from edream import catalog
from edream.core.episode import Episode, Recording
from edream.core.errors import EdreamError
from edream.core.format import Format, Malformed, ReadOptions
from edream.ingest.border import LFS_MARK, head
from edream.ingest.conditions import FILE, about, noted
from edream.ingest.findings import Findings, find
from edream.ingest.mapping import MappingConfig, map_recording, selected

MAX_LOOKED_AT = 1000


def detect_format(path: Path, name: str | None = None) -> Format:
    """The format of what lies at `path`, by its content.

    Args:
        path: a file or folder.
        name: force this format instead.

    Raises:
        EdreamError: nothing is there, or no format or more than one recognises it.
    """
    path = Path(path)
    if not path.exists():
        raise EdreamError(f"There is nothing at {path}; expected a file or folder of recordings.")
    if name not in (None, "auto"):
        return catalog.load("formats", str(name), Format)
    formats = [catalog.load("formats", one, Format) for one in catalog.names("formats")]
    reasons = {one.name: reason for one in formats if (reason := one.recognise(path))}
    if len(reasons) > 1:
        listed = "; ".join(f"{one} ({reason})" for one, reason in reasons.items())
        raise EdreamError(f"{path} may be read in more than one format: {listed}. Choose with ingest.format.")
    if not reasons:
        pointer = _lfs_pointer(path)
        looked = "; ".join(f"{one.name}: {one.summary}" for one in formats)
        hint = f" {pointer} is a Git LFS pointer: run 'git lfs pull' where it came from." if pointer else ""
        raise EdreamError(f"No format recognises {path}.{hint} What each looks for: {looked}.")
    return next(one for one in formats if one.name in reasons)


def read_recordings(path: Path, options: ReadOptions | None = None, format: str | None = None) -> Iterator[Recording | Malformed]:
    """Every recording at `path`, with the numbers of each `conditions.csv` beside them attached.

    Names in `conditions.csv` that no recording has come last, as `Malformed`.

    Raises:
        EdreamError: see `detect_format`; or `conditions.csv` is wrong; or nothing can be read at all.
    """
    path = Path(path)
    known = noted(path)
    met: set[tuple[str, ...]] = set()
    for one in detect_format(path, format).recordings(path, options or ReadOptions()):
        found = about(one.name, known)
        if found is not None:
            met.add(found.names)
            if isinstance(one, Recording):
                one = replace(one, conditions={**one.conditions, **found.numbers})
        yield one
    for row in known:
        if path.is_dir() and row.names not in met:
            yield Malformed(row.names[0], f"{row.file} names it, but there is no such recording in {path}.")


def ingest_recordings(
    path: Path,
    robot_joints: tuple[str, ...],
    options: ReadOptions | None = None,
    mapping: MappingConfig | None = None,
    strict: bool = False,
    format: str | None = None,
    ranges: Mapping[str, tuple[float, float]] | None = None,
) -> Iterator[tuple[Episode, Findings] | Malformed]:
    """Episodes of a robot from whatever recordings lie at `path`, one at a time.

    Args:
        path: file or folder of recordings.
        robot_joints: the robot's actuated joints, (J,).
        options: what the files cannot say about themselves.
        mapping: how channels become joints, and which recordings to take.
        strict: raise at the first recording that is malformed.
        format: name of a format, or None to find it by content.
        ranges: joint -> (low, high) [rad or m], for the findings.

    Yields:
        each episode with its findings, or why a recording was left out.

    Raises:
        EdreamError: nothing at all could be used, no recording is selected, or `strict` and one is malformed.
    """
    mapping = mapping or MappingConfig()
    names: list[str] = []
    used, first = 0, ""
    for one in read_recordings(path, options, format):
        if isinstance(one, Recording):
            names.append(one.name)
            if not selected(one, mapping.select):
                continue
            result = _mapped(one, robot_joints, mapping, ranges)
        else:
            result = one
        if isinstance(result, Malformed):
            if strict:
                raise EdreamError(f"Recording {result.name!r} is malformed: {result.reason} (ingest.strict=true stops here.)")
            first = first or f"{result.name}: {result.reason}"
        else:
            used += 1
        yield result
    if not used and names and mapping.select and not first:
        raise EdreamError(f"No recording matches ingest.select={list(mapping.select)}. What exists: {', '.join(names[:50])}.")
    if not used:
        raise EdreamError(f"None of the recordings at {path} can be used. The first: {first or 'there is none.'}")


def _mapped(
    recording: Recording, joints: tuple[str, ...], mapping: MappingConfig, ranges: Mapping[str, tuple[float, float]] | None
) -> tuple[Episode, Findings] | Malformed:
    try:
        episode = map_recording(recording, joints, mapping)
        return episode, find(episode, ranges)
    except EdreamError as error:
        return Malformed(recording.name, str(error))


def _lfs_pointer(path: Path) -> Path | None:
    files = [path] if path.is_file() else path.rglob("*")
    for count, file in enumerate(files):
        if count > MAX_LOOKED_AT:
            return None
        if file.name != FILE and head(file).startswith(LFS_MARK):
            return file
    return None
