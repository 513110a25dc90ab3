"""Joint states, switches and voltages on topics, put together into a recording."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from edream.core.episode import Recording, Video
from edream.core.errors import EdreamError, unknown_name
from edream.core.format import ReadOptions
from edream.ingest.border import MAX_CHANNELS

COMMAND_WORDS = ("command", "cmd", "action", "desired", "target", "goal", "setpoint", "leader", "master", "reference")
ENABLE_WORDS = ("torque_enable", "torque_enabled", "enable", "enabled", "servo_on", "motors_on")
VOLTAGE_WORDS = ("voltage", "battery")
CLOCKS = ("header", "publish", "log")


@dataclass
class JointTopic:
    """Joint states of one topic, row by row as they were logged."""

    names: tuple[str, ...] = ()
    stamps: list[tuple[int, int, int]] = field(default_factory=list)
    position: list[list[float]] = field(default_factory=list)
    velocity: list[list[float]] = field(default_factory=list)
    effort: list[list[float]] = field(default_factory=list)

    def add(
        self, stamp: tuple[int, int, int], names: tuple[str, ...], values: tuple[list[float], list[float], list[float]]
    ) -> None:
        """Append one message.

        Args:
            stamp: header (0 where there is none), publish and log time [ns].
            names: its joints, in any order.
            values: position, velocity and effort; the latter two may be empty.

        Raises:
            EdreamError: its joints or lengths are not those of the first message.
        """
        if not self.stamps:
            if len(values[0]) > MAX_CHANNELS:
                raise EdreamError(f"a message has {len(values[0])} joints; expected at most {MAX_CHANNELS}.")
            self.names = names
        row = len(self.stamps)
        if names != self.names:
            if sorted(names) != sorted(self.names) or len(set(names)) != len(names):
                raise EdreamError(
                    f"message {row} has joints {', '.join(names) or 'none'}; expected {', '.join(self.names) or 'none'} as before."
                )
            order = [names.index(name) for name in self.names]
            values = tuple([part[i] for i in order] if len(part) == len(names) else part for part in values)  # type: ignore[assignment]
        width = len(self.position[0]) if self.position else len(values[0])
        if len(values[0]) != width or (names and len(names) != width):
            raise EdreamError(f"message {row} has {len(values[0])} positions for {len(names) or width} joints.")
        self.stamps.append(stamp)
        for mine, new in zip((self.position, self.velocity, self.effort), values, strict=True):
            mine.append(new)


@dataclass
class Signals:
    """Everything of one file that a recording is made of, by topic."""

    joints: dict[str, JointTopic] = field(default_factory=dict)
    flags: dict[str, list[tuple[int, int, int, bool]]] = field(default_factory=dict)
    numbers: dict[str, list[float]] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    videos: dict[str, Video] = field(default_factory=dict)


def assemble(name: str, signals: Signals, options: ReadOptions) -> Recording:
    """One recording from the topics of one file, on the clock of its first measurement.

    Raises:
        EdreamError: measured joint states are missing or cannot be told from the commands.
    """
    states, commands = _roles(signals.joints, options)
    clock = _clock([signals.joints[topic] for topic in (*states, *commands)])
    start = signals.joints[states[0]].stamps[0][clock]
    measured = merged([_Arrays.of(signals.joints[topic], clock, start, topic) for topic in states], hold=False)
    commanded = merged([_Arrays.of(signals.joints[topic], clock, start, topic) for topic in commands], hold=True)
    if len(states) > 1 and len(measured.times):  # the clock begins where all topics have begun
        start += round(1e9 * float(measured.times[0]))
        commanded = replace(commanded, times=commanded.times - measured.times[0])
        measured = replace(measured, times=measured.times - measured.times[0])
    conditions, notes = facts(signals)
    notes |= {"clock": f"{CLOCKS[clock]} time", "state_topic": " ".join(states), "command_topic": " ".join(commands) or "none"}
    if len(states) > 1:
        notes["merged"] = f"measurements of {len(states)} topics, the others interpolated to the times of {states[0]}"
    return Recording(
        name=name,
        times=measured.times,
        channels=measured.names,
        position=measured.position,
        command_times=commanded.times,
        command_channels=commanded.names,
        command=commanded.position,
        velocity=measured.velocity,
        effort=measured.effort,
        enabled=_enabled(signals, commanded.times, clock, start),
        videos=rebased(signals.videos, start, clock),
        conditions=conditions,
        notes=notes,
    )


@dataclass(frozen=True)
class _Arrays:
    names: tuple[str, ...]
    times: np.ndarray
    position: np.ndarray
    velocity: np.ndarray | None
    effort: np.ndarray | None

    @staticmethod
    def none() -> "_Arrays":
        return _Arrays((), np.zeros(0), np.zeros((0, 0)), None, None)

    @staticmethod
    def of(topic: JointTopic, clock: int, start: int, name: str) -> "_Arrays":
        position = np.array(topic.position, dtype=np.float64)
        if position.ndim != 2 or position.shape[1] == 0:
            raise EdreamError(f"topic {name} carries no joint positions.")
        full = {}
        for what in ("velocity", "effort"):
            rows = getattr(topic, what)
            whole = all(len(row) == position.shape[1] for row in rows)
            full[what] = np.array(rows, dtype=np.float64) if whole else None
        times = seconds([stamp[clock] for stamp in topic.stamps], start)
        return _Arrays(topic.names, times, position, full["velocity"], full["effort"])


def merged(parts: Sequence[_Arrays], hold: bool) -> _Arrays:
    """Several topics as one, their joints side by side, over the time that all of them cover.

    Args:
        parts: one for each topic.
        hold: whether values hold until the next ones (commands), on the times of all topics together; else they are interpolated
            linearly to the times of the first topic (measurements).

    Raises:
        EdreamError: a joint is in two topics, or the topics share no time.
    """
    if len(parts) < 2:
        return parts[0] if parts else _Arrays.none()
    names = tuple(name for part in parts for name in part.names)
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise EdreamError(f"joint {twice!r} is in two of the topics that are to be merged; expected each in one.")
    first, last = max(part.times[0] for part in parts), min(part.times[-1] for part in parts)
    times = np.unique(np.concatenate([part.times for part in parts])) if hold else parts[0].times
    times = times[(times >= first) & (hold | (times <= last))]
    if not len(times):
        raise EdreamError("the topics that are to be merged share no time.")

    def column(part: _Arrays, values: np.ndarray) -> np.ndarray:
        if hold:
            return values[np.searchsorted(part.times, times, side="right") - 1]
        return np.stack([np.interp(times, part.times, values[:, i]) for i in range(values.shape[1])], axis=1)

    def whole(what: str) -> np.ndarray | None:
        columns = [(part, getattr(part, what)) for part in parts]
        return None if any(v is None for _, v in columns) else np.concatenate([column(p, v) for p, v in columns], axis=1)

    position = np.concatenate([column(part, part.position) for part in parts], axis=1)
    return _Arrays(names, times, position, whole("velocity"), whole("effort"))


def seconds(stamps: list[int], start: int) -> np.ndarray:
    """Integer clocks [ns] as seconds since `start`; subtracted as integers, since a float64 holds no epoch to the nanosecond."""
    return np.array([stamp - start for stamp in stamps], dtype=np.int64) / 1e9


def _roles(joints: Mapping[str, JointTopic], options: ReadOptions) -> tuple[list[str], list[str]]:
    filled = {topic: one for topic, one in joints.items() if one.stamps}
    if not filled:
        raise EdreamError("it holds no joint states.")
    for named in (*options.position, *options.command):
        if named.startswith("/") and named not in filled:
            raise unknown_name("joint state topic", named, filled)
    named_state = [topic for topic in options.position if topic in filled]
    named_command = [topic for topic in options.command if topic in filled]
    commands = named_command or [t for t in filled if t not in named_state and any(word in t.lower() for word in COMMAND_WORDS)]
    states = named_state or [topic for topic in filled if topic not in commands]
    if len(states) != max(1, len(named_state)) or len(commands) > max(1, len(named_command)):
        raise EdreamError(
            f"it has {len(states)} measured and {len(commands)} commanded joint topics ({', '.join(sorted(filled))}); "
            "expected one measured and at "
            "most one commanded. Name them with ingest.position=[/topic] and ingest.command=[/topic]; several are merged."
        )
    return states, commands


def _clock(topics: list[JointTopic]) -> int:
    """The clock that every topic carries and that rises in all of them: header stamps first, for they are taken at the robot."""
    for clock in range(len(CLOCKS)):
        columns = [np.array([stamp[clock] for stamp in topic.stamps], dtype=np.uint64).astype(np.int64) for topic in topics]
        rising = all(len(column) < 2 or (np.diff(column) > 0).all() for column in columns)
        starts = [int(column[0]) for column in columns]
        if rising and (max(starts) - min(starts) < 3600e9) and not all(len(column) > 1 and not column.any() for column in columns):
            return clock
    return 2


def _enabled(signals: Signals, times: np.ndarray, clock: int, start: int) -> np.ndarray | None:
    """The torque switch held onto the command times; before its first message it counts as that message says."""
    named = [topic for topic in signals.flags if topic.strip("/").split("/")[-1].lower() in ENABLE_WORDS]
    if not named or not len(times):
        return None
    rows = signals.flags[sorted(named)[0]]
    # a plain Bool has no header: its publish time stands in
    stamps = seconds([row[clock] or row[1] for row in rows], start)
    order = np.argsort(stamps, kind="stable")
    held = np.searchsorted(stamps[order], times, side="right") - 1
    return np.array([row[3] for row in rows], dtype=bool)[order][np.maximum(held, 0)]


def facts(signals: Signals) -> tuple[dict[str, float], dict[str, str]]:
    """Numbers and texts known about the recording: the metadata record "conditions" and the mean of each voltage topic [V]."""
    conditions: dict[str, float] = {}
    notes: dict[str, str] = {}
    for topic, values in sorted(signals.numbers.items()):
        finite = [value for value in values if np.isfinite(value)]
        if finite and any(word in topic.lower() for word in VOLTAGE_WORDS):
            conditions[topic.strip("/").replace("/", "_")] = float(np.mean(finite))
    for key, text in signals.metadata.get("conditions", {}).items():
        try:
            number = float(text)
        except ValueError:
            notes[key] = text
            continue
        if np.isfinite(number):
            conditions[key] = number
        else:
            notes[key] = text
    return conditions, notes


def rebased(videos: Mapping[str, Video], start: int, clock: int) -> dict[str, Video]:
    """Videos whose times are stamps (T, 3) [ns], on the clock of the recording."""
    return {
        name: Video(
            seconds([int(stamp) for stamp in video.times[:, clock]], start),
            video.height,
            video.width,
            video.frames,
            video.intrinsics,
            video.extrinsics,
        )
        for name, video in videos.items()
    }
