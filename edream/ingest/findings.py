"""What is noteworthy in one episode before anything is fitted to it: clock, encoder, units, shifts, colours."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np
from jaxtyping import Float

from edream.core.episode import Episode, Video
from edream.ingest.causality import answering_early, warning
from edream.ingest.video import encode_image

GAP = 3.0  # a step this many times the median one is a gap
LARGE = 10.0  # rad: no joint of an arm turns this far
DEGREE = 180.0 / np.pi
MAX_LAG = 0.5  # s
MAX_PAUSE = 20  # times as long as its measurements take at the median rate: a recording that is mostly gaps tells no lag
NUMBER = re.compile(r"(?<![\w.])-?\d+(\.\d+)?(e[-+]?\d+)?")  # but not those in names, such as joint1
PREVIEW = 240  # pixel


@dataclass(frozen=True)
class Findings:
    """What was noticed in one episode.

    Attributes:
        name: the episode.
        rows: number of measurements; `rate` their median rate [Hz], `jitter` the standard deviation of their steps [s].
        gaps: (start, length) [s] of each step longer than 3 median steps.
        quantum: joint -> encoder step [rad or m], for joints where one shows.
        dead: joints that do not move although their command does.
        still: joints whose command and position never change.
        units: sentences about values that are hardly in SI units.
        shift: joint -> time by which the measurement follows the command [s], for joints that move.
        skew: joint -> shift less the median over joints [s].
        early: joints whose measurement answers a command in its own row.
        unsigned_effort: efforts are recorded as magnitudes.
        torque_off: time without torque [s].
        unmapped: channels that the robot has no joint for.
        signals: what is kept beside the joints, name -> numbers a row; `left_alone` what is not read.
        previews: camera -> PNG of its first image as read and with red and blue exchanged.
    """

    name: str
    rows: int
    rate: float
    jitter: float
    gaps: tuple[tuple[float, float], ...] = ()
    quantum: Mapping[str, float] = field(default_factory=dict)
    dead: tuple[str, ...] = ()
    still: tuple[str, ...] = ()
    units: tuple[str, ...] = ()
    shift: Mapping[str, float] = field(default_factory=dict)
    skew: Mapping[str, float] = field(default_factory=dict)
    early: tuple[str, ...] = ()
    unsigned_effort: bool = False
    torque_off: float = 0.0
    unmapped: tuple[str, ...] = ()
    signals: Mapping[str, int] = field(default_factory=dict)
    left_alone: tuple[str, ...] = ()
    previews: Mapping[str, bytes] = field(default_factory=dict, repr=False)

    def sentences(self) -> tuple[str, ...]:
        """The findings in words; the clock always, the rest only where there is something to say."""
        said = [f"{self.rows} measurements at {self.rate:.2f} Hz, steps spread by {self.jitter * 1e3:.2f} ms."]
        if self.gaps:
            start, length = max(self.gaps, key=lambda gap: gap[1])
            said.append(f"{len(self.gaps)} gaps; the longest lasts {length * 1e3:.0f} ms from {start:.2f} s on.")
        if self.quantum:
            said.append("Encoder step: " + _listed(self.quantum, 1.0, "{:.3g}", "rad") + ".")
        if self.dead:
            said.append(f"Commanded but never moving: {', '.join(self.dead)}.")
        if self.still:
            said.append(f"Neither commanded to move nor moving: {', '.join(self.still)}.")
        said += self.units
        if self.shift:
            said.append(
                "Measurement follows command by "
                + _listed(self.shift, 1e3, "{:.0f}", "ms")
                + " (motor, controller and delay together)."
            )
        if self.early:
            said.append(warning(self.early))
        if self.unsigned_effort:
            said.append("Efforts are never negative although the joints move both ways: magnitudes only.")
        if self.torque_off > 0:
            said.append(f"Torque is off for {self.torque_off:.2f} s.")
        if self.unmapped:
            said.append(f"Channels that the robot has no joint for: {', '.join(self.unmapped)}.")
        if self.signals:
            kept = ", ".join(f"{name} ({count} numbers a row)" for name, count in self.signals.items())
            said.append(f"Kept beside the joints, and not simulated: {kept}.")
        if self.left_alone:
            said.append(f"Left alone: {', '.join(self.left_alone)}.")
        return tuple(said)


def find(episode: Episode, ranges: Mapping[str, tuple[float, float]] | None = None) -> Findings:
    """Look an episode over. Nothing is altered.

    Args:
        episode: in SI units.
        ranges: joint -> (low, high) of the robot's joints [rad or m], to find values outside.

    Raises:
        EdreamError: the first image of a camera cannot be read.
    """
    steps = np.diff(episode.times)
    middle = float(np.median(steps))
    gaps = np.flatnonzero(steps > GAP * middle)
    moving = np.ptp(episode.position, axis=0) > 0
    commanded = np.ptp(episode.command, axis=0) > 0
    shift = shifts(episode)
    typical = float(np.median(list(shift.values()))) if shift else 0.0
    columns = range(len(episode.joints))
    quanta = {episode.joints[j]: quantum(episode.position[:, j]) for j in columns}
    return Findings(
        name=episode.name,
        rows=len(episode.times),
        rate=1.0 / middle,
        jitter=float(np.std(steps)),
        gaps=tuple((float(episode.times[row]), float(steps[row])) for row in gaps),
        quantum={joint: step for joint, step in quanta.items() if step is not None},
        dead=tuple(episode.joints[j] for j in columns if commanded[j] and not moving[j]),
        still=tuple(episode.joints[j] for j in columns if not commanded[j] and not moving[j]),
        units=_unit_mistakes(episode, ranges or {}),
        shift=shift,
        skew={joint: value - typical for joint, value in shift.items()},
        early=answering_early([episode]),
        unsigned_effort=_unsigned(episode),
        torque_off=_torque_off(episode),
        unmapped=tuple(part for part in episode.notes.get("unmapped_channels", "").split(", ") if part),
        signals={name: numbers.shape[1] for name, numbers in episode.signals.items()},
        left_alone=tuple(part for part in episode.notes.get("left_alone", "").split(", ") if part),
        previews={name: _preview(video) for name, video in episode.videos.items()},
    )


def summarise(found: Sequence[Findings]) -> tuple[str, ...]:
    """One data set's findings in words: the clock, then every finding with the number of episodes it occurs in."""
    if not found:
        return ("No episode.",)
    rates = [one.rate for one in found]
    joints = list(dict.fromkeys(joint for one in found for joint in one.shift))
    said = [
        f"{len(found)} episodes at {min(rates):.2f} to {max(rates):.2f} Hz, {sum(one.rows for one in found)} measurements in all."
    ]
    gaps = [gap for one in found for gap in one.gaps]
    if gaps:
        said.append(
            f"{len(gaps)} gaps in {sum(bool(one.gaps) for one in found)} episodes; the longest lasts "
            f"{max(g[1] for g in gaps) * 1e3:.0f} ms."
        )
    steps = {
        joint: float(np.median([one.quantum[joint] for one in found if joint in one.quantum])) for joint in _seen(found, "quantum")
    }
    if steps:
        said.append("Encoder step: " + _listed(steps, 1.0, "{:.3g}", "rad") + ".")
    if joints:
        middle = {joint: float(np.median([one.shift[joint] for one in found if joint in one.shift])) for joint in joints}
        said.append("Measurement follows command by " + _listed(middle, 1e3, "{:.0f}", "ms") + " (median over episodes).")
        spread = max(middle.values()) - min(middle.values())
        if spread > 0.5 / float(np.median(rates)):
            said.append(
                f"That differs by {spread * 1e3:.0f} ms between joints: different loads or servos, or readings taken "
                "one after another."
            )
    rest: dict[str, list[str]] = {}  # what differs by its numbers alone is one finding
    for one in found:
        for sentence in one.sentences():
            if not _numeric(sentence):
                rest.setdefault(NUMBER.sub("0", sentence), []).append(sentence)
    for same in sorted(rest.values(), key=lambda some: (-len(some), some[0])):
        such = "" if len(set(same)) == 1 else ", such as this"
        said.append(f"{same[0]} ({len(same)} of {len(found)} episodes{such})")
    return tuple(said)


def quantum(values: Float[np.ndarray, "T"]) -> float | None:
    """The step that all values are whole multiples of (plus a constant), or None where there is none.

    Single precision leaves a residue of about 1e-7 of the value, so steps within it count as one.
    """
    noise = 4e-7 * max(1.0, float(np.abs(values).max()))
    levels = np.unique(values)
    differences = np.diff(levels)
    differences = differences[differences > noise]
    if len(differences) < 3:
        return None
    smallest = float(np.quantile(differences, 0.05))
    if smallest < 20 * noise:
        return None
    close = differences[(differences > 0.6 * smallest) & (differences < 5.5 * smallest)]
    if not len(close):
        return None
    step = float(np.median(close / np.round(close / smallest)))
    whole = np.abs(differences / step - np.round(differences / step)) * step < max(0.02 * step, 3 * noise)
    return step if np.mean(whole) > 0.95 else None


def shifts(episode: Episode) -> dict[str, float]:
    """Time by which each joint's measurement follows its command [s], by the peak of their velocities' cross-correlation.

    Empty for a recording that is too short, or mostly a gap; a joint that does not follow its command is left out.
    """
    step = float(np.median(np.diff(episode.times)))
    if np.ptp(episode.times) > MAX_PAUSE * step * len(episode.times):
        return {}
    grid = np.arange(episode.times[0], episode.times[-1], step)
    reach = min(int(MAX_LAG / step), len(grid) // 4)
    if reach < 2:
        return {}
    # a command stamped a rounding error after the grid point counts as there already
    held = np.clip(np.searchsorted(episode.command_times, grid + 1e-3 * step, side="right") - 1, 0, None)
    found = {}
    for column, joint in enumerate(episode.joints):
        measured = np.diff(np.interp(grid, episode.times, episode.position[:, column]))
        commanded = np.diff(episode.command[held, column])
        size = np.linalg.norm(measured) * np.linalg.norm(commanded)
        if size <= 0:
            continue
        spectrum = np.fft.rfft(measured, 2 * len(measured)) * np.conj(np.fft.rfft(commanded, 2 * len(measured)))
        both = np.fft.irfft(spectrum)
        lags = np.arange(-reach, reach + 1)
        correlation = both[lags] / size
        top = int(np.argmax(correlation))
        # an even weaker peak is noise, not motion that follows a command
        if correlation[top] > 0.3 and 0 < top < len(lags) - 1:
            left, peak, right = correlation[top - 1 : top + 2]
            bend = left - 2 * peak + right
            found[joint] = float((lags[top] + (0.5 * (left - right) / bend if bend < 0 else 0.0)) * step)
    return found


def _unit_mistakes(episode: Episode, ranges: Mapping[str, tuple[float, float]]) -> tuple[str, ...]:
    said = []
    for column, joint in enumerate(episode.joints):
        position, command = episode.position[:, column], episode.command[:, column]
        ratio = _gain(command, position)
        if ratio is not None and 0.6 < ratio / DEGREE < 1.6:
            said.append(f"Joint {joint!r}: commands are about {DEGREE:.1f} times the positions: degrees beside radians?")
        elif ratio is not None and 0.6 < ratio * DEGREE < 1.6:
            said.append(f"Joint {joint!r}: positions are about {DEGREE:.1f} times the commands: degrees beside radians?")
        elif np.abs(command).max() > LARGE and np.ptp(command) == 0:
            said.append(f"Joint {joint!r}: its command is {command[0]:g} throughout: a dummy target?")
        else:
            for what, values in (("command", command), ("position", position)):
                if np.abs(values).max() > LARGE:
                    said.append(
                        f"Joint {joint!r}: its {what} reaches {values[np.argmax(np.abs(values))]:g} rad: degrees, per "
                        "cent or a dummy target?"
                    )
        low, high = ranges.get(joint, (-np.inf, np.inf))
        margin = 0.05 * (high - low) if np.isfinite(high - low) else 0.0
        share = float(np.mean((position < low - margin) | (position > high + margin)))
        if share > 0:
            said.append(
                f"Joint {joint!r}: {share:.0%} of its positions lie outside its range {low:.3f} to {high:.3f} (they "
                f"reach {position.min():.3f} to {position.max():.3f})."
            )
    return tuple(said)


def _gain(command: np.ndarray, position: np.ndarray) -> float | None:
    """How many times larger the command moves than the position, robustly; None where one of them is still."""
    wide = np.quantile(command, 0.95) - np.quantile(command, 0.05)
    narrow = np.quantile(position, 0.95) - np.quantile(position, 0.05)
    return float(wide / narrow) if wide > 0 and narrow > 0 else None


def _unsigned(episode: Episode) -> bool:
    if episode.effort is None or not np.isfinite(episode.effort).all():
        return False
    moved = np.diff(episode.position, axis=0)
    both_ways = (moved > 0).any() and (moved < 0).any()
    return bool(both_ways and (episode.effort >= 0).all() and (episode.effort > 0).any())


def _torque_off(episode: Episode) -> float:
    if episode.enabled is None:
        return 0.0
    ends = np.append(episode.command_times[1:], max(episode.times[-1], episode.command_times[-1]))
    return float(np.sum((ends - episode.command_times)[~episode.enabled]))


def _preview(video: Video) -> bytes:
    image = next(iter(video.frames()))
    scale = min(1.0, PREVIEW / max(image.shape[:2]))
    size = (max(1, round(image.shape[1] * scale)), max(1, round(image.shape[0] * scale)))
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    return encode_image(np.concatenate([small, small[:, :, ::-1]], axis=1), "png")


def _seen(found: Sequence[Findings], what: str) -> list[str]:
    return list(dict.fromkeys(joint for one in found for joint in getattr(one, what)))


def _numeric(sentence: str) -> bool:
    """Whether a sentence is summed up by numbers elsewhere or differs in every episode."""
    return any(mark in sentence for mark in (" measurements at ", " gaps; ", "Encoder step", "Measurement follows"))


def _listed(values: Mapping[str, float], factor: float, form: str, unit: str) -> str:
    texts = {joint: form.format(value * factor) for joint, value in values.items()}
    if len(set(texts.values())) == 1:
        return f"{next(iter(texts.values()))} {unit} on {'all joints' if len(texts) > 1 else next(iter(texts))}"
    return ", ".join(f"{text} {unit} ({joint})" for joint, text in texts.items())
