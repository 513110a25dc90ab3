"""Episode files and their index, read back."""

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from edream.core.episode import Episode, Recording
from edream.core.errors import EdreamError
from edream.ingest import mcap_file
from edream.ingest.episode_file import COMMANDS, PROFILE, SIGNAL, STATES, SWITCH
from edream.ingest.foxglove import read_signals
from edream.ingest.signals import Signals, rebased, seconds

LOG = 2


def read_episode(path: Path) -> Episode:
    """The episode in a file that `write_episode` made, every number as it was; images are read when asked for.

    Raises:
        EdreamError: it is no such file, or is damaged.
    """
    recording = read_recording(path)
    return Episode(
        name=recording.name,
        joints=recording.channels,
        times=recording.times,
        position=recording.position,
        command_times=recording.command_times,
        command=recording.command,
        velocity=recording.velocity,
        effort=recording.effort,
        enabled=recording.enabled,
        videos=recording.videos,
        conditions=recording.conditions,
        notes=recording.notes,
        signals=recording.signals,
    )


def read_recording(path: Path) -> Recording:
    """The same file as a recording, channels named after the joints.

    Raises:
        EdreamError: it is no such file, or is damaged.
    """
    topics = mcap_file.peek(path)
    if topics is not None and topics.profile != PROFILE:
        raise EdreamError(
            f"{path} is an MCAP file of another program (profile {topics.profile!r}); run 'edream ingest' on it first."
        )
    signals = read_signals(path)
    about = signals.metadata.get("episode", {})
    try:
        joints = tuple(str(joint) for joint in json.loads(about["joints"]))
        name, start = about["name"], int(about["start_ns"])
        cameras = [str(camera) for camera in json.loads(about["cameras"])]
        extra = [str(signal) for signal in json.loads(about.get("signals", "[]"))]
        conditions = {key: float(value) for key, value in signals.metadata.get("conditions", {}).items()}
    except (KeyError, ValueError, TypeError, RecursionError) as error:
        raise EdreamError(f"{path} is damaged: its metadata record 'episode' is missing or unreadable ({error}).") from error
    times, position, velocity, effort = _table(path, signals, STATES, joints, start)
    command_times, command, _, _ = _table(path, signals, COMMANDS, joints, start)
    videos = rebased(signals.videos, start, LOG)
    if sorted(videos) != sorted(cameras):
        raise EdreamError(
            f"{path} is damaged: it has images of {', '.join(sorted(videos)) or 'no camera'}; expected "
            f"{', '.join(sorted(cameras)) or 'none'}."
        )
    return Recording(
        name=name,
        times=times,
        channels=joints,
        position=position,
        command_times=command_times,
        command_channels=joints,
        command=command,
        velocity=velocity,
        effort=effort,
        enabled=_held(signals, command_times, start),
        videos={camera: videos[camera] for camera in cameras},
        conditions=conditions,
        notes=signals.metadata.get("notes", {}),
        signals={name: _signal(path, signals, name, len(times)) for name in extra},
    )


def _table(
    path: Path, signals: Signals, topic: str, joints: tuple[str, ...], start: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray | None, np.ndarray | None]:
    if topic not in signals.joints or signals.joints[topic].names != joints:
        raise EdreamError(f"{path} is damaged: topic {topic} does not carry the joints {', '.join(joints) or 'none'}.")
    rows = signals.joints[topic]
    shape = (len(rows.stamps), len(joints))
    parts: list[np.ndarray | None] = []
    for part in (rows.position, rows.velocity, rows.effort):
        whole = all(len(row) == len(joints) for row in part) and (bool(joints) or part is rows.position)
        parts.append(np.array(part, dtype=np.float64).reshape(shape) if whole else None)
    if parts[0] is None:
        raise EdreamError(f"{path} is damaged: topic {topic} lacks positions.")
    return seconds([stamp[LOG] for stamp in rows.stamps], start), parts[0], parts[1], parts[2]


def _signal(path: Path, signals: Signals, name: str, rows: int) -> np.ndarray:
    topic = f"{SIGNAL}/{name}"
    found = np.array(signals.joints[topic].position, dtype=np.float64) if topic in signals.joints else np.zeros((0, 0))
    if found.ndim != 2 or len(found) != rows:
        raise EdreamError(f"{path} is damaged: topic {topic} has numbers of shape {found.shape}; expected {rows} rows.")
    return found


def _held(signals: Signals, times: np.ndarray, start: int) -> np.ndarray | None:
    if SWITCH not in signals.flags:
        return None
    rows = signals.flags[SWITCH]
    stamps = seconds([row[LOG] for row in rows], start)
    held = np.maximum(np.searchsorted(stamps, times, side="right") - 1, 0)
    return np.array([row[3] for row in rows], dtype=bool)[held]


def episode_files(folder: Path) -> list[Path]:
    """Episode files of a folder, in the order of their names.

    Raises:
        EdreamError: there is none.
    """
    files = sorted(folder.glob("*.mcap"))
    if not files:
        raise EdreamError(f"There is no episode (*.mcap) in {folder}; run 'edream ingest' first.")
    return files


def read_episodes(folder: Path) -> Iterator[Episode]:
    """Every episode of a folder, one at a time."""
    for file in episode_files(folder):
        yield read_episode(file)
