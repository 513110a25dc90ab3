"""Channels of a recording -> joints of a robot, in SI units, on a clock that starts at 0."""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase

import numpy as np

from edream.core.episode import Episode, Recording, Video
from edream.core.errors import EdreamError, unknown_name

UNITS = {"rad": 1.0, "m": 1.0, "deg": math.pi / 180.0, "mm": 1e-3}
SUFFIXES = (".pos", ".position", "_pos", "_position", ".q", "/position", ".cmd", "_command", "/pos")
GENERIC = re.compile(r"(motor|joint|servo|axis|channel|state|action|dim|q|j)?[_\- ]?\d+")


@dataclass(frozen=True)
class MappingConfig:
    """How channels become joints.

    Attributes:
        by: "auto" (named, explicit or, where the file names nothing, in order), "name", "order", or "none" for video only.
        channels: joint -> channel, for names that differ.
        unit: unit of all stored values: "rad", "deg", "m", "mm" or "normalised".
        units: joint -> unit, where one joint differs.
        scale, offset: joint -> numbers with `joint = scale * stored + offset` [rad or m], for "normalised".
        select: names or glob patterns of recordings (or of their task) to keep; empty for all.
    """

    by: str = "auto"
    channels: Mapping[str, str] = field(default_factory=dict)
    unit: str = "rad"
    units: Mapping[str, str] = field(default_factory=dict)
    scale: Mapping[str, float] = field(default_factory=dict)
    offset: Mapping[str, float] = field(default_factory=dict)
    select: tuple[str, ...] = ()


def selected(recording: Recording, select: Sequence[str]) -> bool:
    """Whether a recording's name or task matches one of the patterns; True where there are none."""
    texts = (recording.name, recording.notes.get("task", ""))
    return not select or any(fnmatchcase(text, pattern) for pattern in select for text in texts if text)


def map_recording(recording: Recording, joints: tuple[str, ...], mapping: MappingConfig) -> Episode:
    """One recording on a robot's joints, in SI units.

    Clocks are moved so that the first measurement is at 0 and are kept to the nanosecond. Channels that no joint takes are
    named in the note `unmapped_channels`.

    Args:
        recording: as its file tells it.
        joints: the robot's actuated joints, (J,).
        mapping: see `MappingConfig`.

    Raises:
        EdreamError: a joint has no channel, a unit is unknown, or the values are unusable.
    """
    _check_config(joints, mapping)
    measured = _columns(recording, "measured", recording.channels, recording.position.shape[1], joints, mapping)
    if mapping.by != "none" and len(recording.command) == 0:
        raise EdreamError(
            f"Recording {recording.name!r} holds no commanded positions; only ingest.mapping.by=none (video only) can take it."
        )
    commanded = _columns(recording, "commanded", recording.command_channels, recording.command.shape[1], joints, mapping)
    taken = () if mapping.by == "none" else joints
    scale, offset = _units(taken, mapping)
    start = float(recording.times[0])
    times, command_times = _clock(recording.times, start), _clock(recording.command_times, start)
    command = recording.command[:, commanded] * scale + offset
    enabled = recording.enabled
    if len(command_times) < 2 and mapping.by == "none":
        command_times, command, enabled = times, np.zeros((len(times), 0)), None
    left = [name for column, name in enumerate(recording.channels) if column not in measured]
    notes = dict(recording.notes) | ({"unmapped_channels": ", ".join(left)} if left else {})
    return Episode(
        name=recording.name,
        joints=taken,
        times=times,
        position=recording.position[:, measured] * scale + offset,
        command_times=command_times,
        command=command,
        velocity=None if recording.velocity is None else recording.velocity[:, measured] * scale,
        effort=None if recording.effort is None else recording.effort[:, measured],
        enabled=enabled,
        videos={name: _moved(video, start) for name, video in recording.videos.items()},
        conditions=dict(recording.conditions),
        notes=notes,
        signals=dict(recording.signals),
    )


def _check_config(joints: tuple[str, ...], mapping: MappingConfig) -> None:
    if mapping.by not in ("auto", "name", "order", "none"):
        raise unknown_name("way to map channels (ingest.mapping.by)", mapping.by, ("auto", "name", "order", "none"))
    for what in ("channels", "units", "scale", "offset"):
        for joint in getattr(mapping, what):
            if joint not in joints:
                raise unknown_name(f"joint (named in ingest.mapping.{what})", joint, joints)
    for unit in (mapping.unit, *mapping.units.values()):
        if unit not in UNITS and unit != "normalised":
            raise unknown_name("unit (ingest.mapping.unit)", unit, (*UNITS, "normalised"))


def _units(joints: tuple[str, ...], mapping: MappingConfig) -> tuple[np.ndarray, np.ndarray]:
    scale, offset = np.ones(len(joints)), np.zeros(len(joints))
    for column, joint in enumerate(joints):
        unit = mapping.units.get(joint, mapping.unit)
        if unit == "normalised" and joint not in mapping.scale:
            raise EdreamError(
                f"Joint {joint!r} is stored normalised; give ingest.mapping.scale.{joint} and "
                f"ingest.mapping.offset.{joint} [rad or m]."
            )
        scale[column] = UNITS.get(unit, 1.0) * mapping.scale.get(joint, 1.0)
        offset[column] = mapping.offset.get(joint, 0.0)
    if not (np.isfinite(scale).all() and np.isfinite(offset).all() and scale.all()):
        raise EdreamError("ingest.mapping.scale and ingest.mapping.offset must be finite, and no scale 0.")
    return scale, offset


def _columns(
    recording: Recording, what: str, names: tuple[str, ...], width: int, joints: tuple[str, ...], mapping: MappingConfig
) -> list[int]:
    """Column of each joint."""
    if mapping.by == "none":
        return []
    nameless = not names or all(GENERIC.fullmatch(_bare(name)) for name in names)
    if mapping.by == "order" or (mapping.by == "auto" and nameless and not mapping.channels and not set(names) & set(joints)):
        if width != len(joints):
            raise EdreamError(
                f"Recording {recording.name!r} has {width} {what} channels; the robot has {len(joints)} joints "
                f"({', '.join(joints)}). "
                "Mapping by order needs as many; name them with ingest.mapping.channels, or the recorded joints with robot.joints."
            )
        return list(range(width))
    return [_find(recording, what, names, joint, joints, mapping) for joint in joints]


def _find(
    recording: Recording, what: str, names: tuple[str, ...], joint: str, joints: tuple[str, ...], mapping: MappingConfig
) -> int:
    wanted = mapping.channels.get(joint, joint)
    for form in (str, _stripped, _bare):
        hits = [column for column, name in enumerate(names) if form(name) == form(wanted)]
        if len(hits) == 1:
            return hits[0]
        if len(hits) > 1:
            listed = ", ".join(names[column] for column in hits)
            raise EdreamError(
                f"Recording {recording.name!r}: joint {joint!r} may be any of the {what} channels {listed}; choose "
                "with ingest.mapping.channels."
            )
    raise EdreamError(
        f"Recording {recording.name!r} has no {what} channel for joint {joint!r} of the robot. "
        f"{unknown_name('channel', wanted, names)} "
        f"Name it with ingest.mapping.channels.{joint}=CHANNEL{', or map by order' if len(names) == len(joints) else ''}"
        "; or, where it was not recorded, name those that were as robot.joints=[JOINT,...]."
    )


def _stripped(name: str) -> str:
    """A channel's name without the suffix that says it is a position."""
    for suffix in SUFFIXES:
        if name.endswith(suffix) and len(name) > len(suffix):
            return name.removesuffix(suffix)
    return name


def _bare(name: str) -> str:
    """A channel's name without suffix, namespace and case."""
    return re.split(r"[/.]", _stripped(name))[-1].lower()


def _clock(times: np.ndarray, start: float) -> np.ndarray:
    """Seconds since `start`, on whole nanoseconds, so that an episode file keeps them exactly."""
    return np.round((times - start) * 1e9) / 1e9


def _moved(video: Video, start: float) -> Video:
    return replace(video, times=_clock(video.times, start))
