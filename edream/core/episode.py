"""What a user brings (`Recording`) and what edream works on (`Episode`)."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from edream.core.errors import EdreamError


@dataclass(frozen=True, eq=False)
class Video:
    """One camera's images, read when asked for and never held as a whole.

    Attributes:
        times: seconds since the episode's first measurement, (T,), rising.
        height, width: size in pixels.
        frames: opens the images anew, each (height, width, 3) uint8 RGB, as many as there are times.
        intrinsics: pinhole matrix [pixel], (3, 3), or None where it is not known.
        extrinsics: camera pose in the robot's base frame, (4, 4) or one a frame (T, 4, 4), x right, y down, z forward, or None.
    """

    times: Float[np.ndarray, "T"]
    height: int
    width: int
    frames: Callable[[], Iterator[UInt8[np.ndarray, "H W 3"]]]
    intrinsics: Float[np.ndarray, "3 3"] | None = None
    extrinsics: Float[np.ndarray, "*T 4 4"] | None = None


@dataclass(frozen=True, eq=False)
class Recording:
    """One episode as its file tells it, before its channels are mapped to a robot's joints.

    Values are as stored: units, order and names are the file's own; only the clock is in seconds.

    Attributes:
        name: name of the episode, unique within its data set.
        times: clock of the measurements [s], (T,).
        channels: name of each measured channel, (C,), empty where the file names none.
        position: measured positions, (T, C).
        command_times: clock of the commands [s], (K,).
        command_channels: name of each commanded channel, (D,), empty where the file names none.
        command: commanded positions, (K, D).
        velocity, effort: measured, (T, C), or None where not recorded.
        enabled: whether torque was on, at each command time, (K,), or None where not recorded.
        videos: camera name -> images.
        conditions: known facts of this recording (gain, payload, supply voltage), name -> number.
        notes: other facts worth keeping (task text, robot type, source file), name -> text.
        signals: numbers of no joint, such as the commands of a mobile base, on the measurements' clock, name -> (T, D).
    """

    name: str
    times: Float[np.ndarray, "T"]
    channels: tuple[str, ...]
    position: Float[np.ndarray, "T C"]
    command_times: Float[np.ndarray, "K"]
    command_channels: tuple[str, ...]
    command: Float[np.ndarray, "K D"]
    velocity: Float[np.ndarray, "T C"] | None = None
    effort: Float[np.ndarray, "T C"] | None = None
    enabled: Bool[np.ndarray, "K"] | None = None
    videos: Mapping[str, Video] = field(default_factory=dict)
    conditions: Mapping[str, float] = field(default_factory=dict)
    notes: Mapping[str, str] = field(default_factory=dict)
    signals: Mapping[str, Float[np.ndarray, "T D"]] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Episode:
    """One recorded motion of one robot, in SI units, on the robot's joints.

    Attributes:
        name: name of the episode, unique within its data set.
        joints: the robot's actuated joints, in the order of the columns, (J,).
        times: clock of the measurements [s], (T,), starting at 0, strictly rising.
        position: measured joint positions [rad or m], (T, J).
        command_times: clock of the commands [s], (K,), on the same clock, strictly rising.
        command: commanded joint positions [rad or m], (K, J); each holds until the next (zero-order hold).
        velocity: measured joint velocities [rad/s or m/s], (T, J), or None.
        effort: measured joint efforts in the recorder's unit, (T, J), or None.
        enabled: whether torque was on from each command time on, (K,), or None for always.
        videos: camera name -> images.
        conditions: known facts of this recording, name -> number.
        notes: other facts worth keeping, name -> text.
        signals: numbers of no joint, as stored, on the measurements' clock, name -> (T, D).
    """

    name: str
    joints: tuple[str, ...]
    times: Float[np.ndarray, "T"]
    position: Float[np.ndarray, "T J"]
    command_times: Float[np.ndarray, "K"]
    command: Float[np.ndarray, "K J"]
    velocity: Float[np.ndarray, "T J"] | None = None
    effort: Float[np.ndarray, "T J"] | None = None
    enabled: Bool[np.ndarray, "K"] | None = None
    videos: Mapping[str, Video] = field(default_factory=dict)
    conditions: Mapping[str, float] = field(default_factory=dict)
    notes: Mapping[str, str] = field(default_factory=dict)
    signals: Mapping[str, Float[np.ndarray, "T D"]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        t, k, j = len(self.times), len(self.command_times), len(self.joints)
        shapes = {
            "position": (self.position, (t, j)),
            "command": (self.command, (k, j)),
            "velocity": (self.velocity, (t, j)),
            "effort": (self.effort, (t, j)),
            "enabled": (self.enabled, (k,)),
        } | {f"signal {name!r}": (array, (t, *array.shape[1:2])) for name, array in self.signals.items()}
        for what, (array, expected) in shapes.items():
            if array is not None and array.shape != expected:
                raise EdreamError(f"Episode {self.name!r}: {what} has shape {array.shape}; expected {expected}.")
        for what, clock in (("measurement", self.times), ("command", self.command_times)):
            _check_clock(self.name, what, clock)
        for what in ("position", "command"):
            bad = np.argwhere(~np.isfinite(getattr(self, what)))
            if len(bad):
                row, column = bad[0]
                raise EdreamError(
                    f"Episode {self.name!r}: {what} of joint {self.joints[column]!r} is not a finite number at row {row}; "
                    f"{len(bad)} such values in all. Expected finite numbers only."
                )

    def in_force(self, clock: Float[np.ndarray, "N"]) -> Int[np.ndarray, "N"]:
        """Row of the command that holds at each time [s] (zero-order hold); the first before there is one."""
        return np.maximum(np.searchsorted(self.command_times, clock + 1e-9, side="right") - 1, 0)

    @property
    def duration(self) -> float:
        """Length of the motion [s]."""
        return float(self.times[-1] - self.times[0])


def _check_clock(name: str, what: str, clock: np.ndarray) -> None:
    if len(clock) < 2:
        raise EdreamError(f"Episode {name!r}: {len(clock)} {what} rows; expected at least 2.")
    if not np.isfinite(clock).all():
        raise EdreamError(f"Episode {name!r}: its {what} clock is not finite at row {int(np.argmin(np.isfinite(clock)))}.")
    steps = np.diff(clock)
    if (steps <= 0).any():
        row = int(np.argmax(steps <= 0)) + 1
        raise EdreamError(
            f"Episode {name!r}: its {what} clock goes from {clock[row - 1]:.6f} s to {clock[row]:.6f} s at row {row}; "
            "expected strictly rising times."
        )
