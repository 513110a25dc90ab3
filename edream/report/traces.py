"""One joint's motion as it was commanded, measured and simulated."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pyarrow as pa
from jaxtyping import Float


@dataclass(frozen=True, eq=False)
class Trace:
    """One joint in one motion; positions [rad], all (T,).

    Attributes:
        motion, joint: whose it is.
        time: since the motion began [s].
        command, measured, before, after: positions; `before` and `after` are simulated, `command` is NaN where it is no position.
        load: torque of gravity [N m], or None where it is not known.
    """

    motion: str
    joint: str
    time: Float[np.ndarray, "T"]
    command: Float[np.ndarray, "T"]
    measured: Float[np.ndarray, "T"]
    before: Float[np.ndarray, "T"]
    after: Float[np.ndarray, "T"]
    load: Float[np.ndarray, "T"] | None = None

    @cached_property
    def speed(self) -> Float[np.ndarray, "T"]:
        """Measured speed [rad/s], smoothed over five measurements."""
        return _smooth(np.gradient(self.measured, self.time))

    @property
    def follows(self) -> bool:
        """Whether the joint is asked for positions, and not for a torque or a speed."""
        return bool(np.isfinite(self.command).any())

    def error(self, side: str) -> Float[np.ndarray, "T"]:
        """Simulated less measured [rad]."""
        return getattr(self, side) - self.measured

    def rms(self, side: str) -> float:
        """Root-mean-square error [rad]; infinite where the simulation blew up."""
        value = float(np.sqrt(np.mean(self.error(side) ** 2)))
        return value if np.isfinite(value) else float("inf")

    def part(self, first: float, last: float) -> "Trace":
        """The stretch between two times [s]."""
        rows = (self.time >= first) & (self.time <= last)
        load = None if self.load is None else self.load[rows]
        command, measured = self.command[rows], self.measured[rows]
        return Trace(self.motion, self.joint, self.time[rows], command, measured, self.before[rows], self.after[rows], load)


def from_rows(table: pa.Table) -> list[Trace]:
    """Traces of a table with one row a (motion, joint, time)."""
    columns = {name: table[name].to_numpy() for name in ("time", "command", "measured", "before", "after", "load")}
    motions, joints = (np.asarray(table[name].to_pylist(), dtype=object) for name in ("motion", "joint"))
    if not len(motions):
        return []
    cuts = np.flatnonzero((motions[1:] != motions[:-1]) | (joints[1:] != joints[:-1])) + 1
    return [
        Trace(str(motions[rows[0]]), str(joints[rows[0]]), **{name: values[rows] for name, values in columns.items()})
        for rows in np.split(np.arange(len(motions)), cuts)
    ]


def from_lists(table: pa.Table, joints: Sequence[str]) -> list[Trace]:
    """Traces of a table with one row a (episode, time) and a list over the joints in each cell."""
    episodes = np.asarray(table["episode"].to_pylist(), dtype=object)
    time = table["time"].to_numpy()
    names = ("command", "measured", "before", "after")
    blocks = {name: np.array(table[name].to_pylist(), dtype=float).reshape(len(time), -1) for name in names}
    cuts = np.flatnonzero(episodes[1:] != episodes[:-1]) + 1
    return [
        Trace(str(episodes[rows[0]]), joint, time[rows], *(blocks[name][rows, j] for name in names))
        for rows in np.split(np.arange(len(time)), cuts)
        if len(rows)
        for j, joint in enumerate(joints)
    ]


def worst_and_median(traces: Sequence[Trace], chosen: Sequence[str]) -> list[str]:
    """The motion with the largest error before, and the one in the middle, of those chosen."""
    names = [name for name in dict.fromkeys(trace.motion for trace in traces) if name in set(chosen)]
    size = {name: max(trace.rms("before") for trace in traces if trace.motion == name) for name in names}
    order = sorted(names, key=lambda name: (-size[name], name))
    return list(dict.fromkeys([order[0], order[len(order) // 2]])) if order else []


def busiest_joints(traces: Sequence[Trace], most: int) -> list[str]:
    """The joints with the largest errors before, largest first; none with less than a third of the largest."""
    joints = list(dict.fromkeys(trace.joint for trace in traces))
    size = {
        joint: float(np.sqrt(np.mean([min(t.rms("before"), 1e3) ** 2 for t in traces if t.joint == joint]))) for joint in joints
    }
    order = sorted(joints, key=lambda joint: -size[joint])
    return [joint for joint in order if size[joint] >= size[order[0]] / 3][:most]


def worst_stretch(trace: Trace, seconds: float, visible: bool = False) -> tuple[float, float]:
    """The stretch of that length [s] with largest error before; with `visible`, beside how far the joint moves in it."""
    if trace.time[-1] - trace.time[0] <= seconds:
        return float(trace.time[0]), float(trace.time[-1])
    error = np.nan_to_num(trace.error("before")) ** 2
    total = np.concatenate([[0.0], np.cumsum(error)])
    last = np.searchsorted(trace.time, trace.time + seconds, side="right")
    full = trace.time + seconds <= trace.time[-1] + 1e-9
    score = np.sqrt((total[last] - total[:-1]) / np.maximum(last - np.arange(len(last)), 1))
    if visible:
        ends = zip(range(len(last)), last, strict=True)
        score /= np.array([np.ptp(trace.measured[a:b]) for a, b in ends]) + 0.05 * np.ptp(trace.measured) + 1e-9
    first = int(np.argmax(np.where(full, score, -1.0)))
    return float(trace.time[first]), float(trace.time[first] + seconds)


def _smooth(values: Float[np.ndarray, "T"]) -> Float[np.ndarray, "T"]:
    padded = np.pad(values, 2, mode="edge")
    return np.convolve(padded, np.ones(5) / 5, mode="valid")
