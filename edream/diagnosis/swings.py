"""What swings in time whatever the robot is told: a fan, a hum, a floor that shakes.

Source: Schuster, Terrestrial Magnetism 3(1), 1898 (periodogram).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float
from scipy.signal import find_peaks

from edream.diagnosis.descent import Fit
from edream.diagnosis.problem import Problem

LOWEST, HIGHEST = 0.2, 10.0  # Hz
TURNS = 3.0  # that a motion must have of a swing
FINE = 8  # frequencies that are looked at for each that a motion can tell apart
MOST = 3  # frequencies
CLEARER = 4.0  # times the share of what is left that the commands have at a frequency: else they may be what swings
MAINLY = 0.5  # of what is left on a joint, for its swing to be worth a word


@dataclass(frozen=True)
class Swing:
    """One frequency [Hz], and the share of what is left that has it, each motion in a phase of its own."""

    frequency: float
    share: float


@dataclass(frozen=True, eq=False)
class _Series:
    """Something over time in each of several motions, its mean taken off; times [s] from the start of each recording."""

    times: Sequence[Float[np.ndarray, "T"]]
    values: Sequence[Float[np.ndarray, "T"]]

    @property
    def power(self) -> float:
        """Sum of squares over all motions."""
        return max(sum(float(np.sum((v - v.mean()) ** 2)) for v in self.values), 1e-30)

    def spectra(self, step: float, length: int) -> Complex[np.ndarray, "M F"]:
        """The Fourier sums of each motion at the frequencies of a transform of `length` even rows, a step [s] apart."""
        rows = []
        for t, v in zip(self.times, self.values, strict=True):
            even = np.interp(np.arange(t[0], t[-1], step), t, v - v.mean())
            rows.append(np.exp(-2j * np.pi * np.fft.rfftfreq(length, step) * t[0]) * np.fft.rfft(even, length))
        return np.array(rows)

    def at(self, frequency: float) -> Complex[np.ndarray, "M 1"]:
        """The Fourier sums of each motion at one frequency [Hz]."""
        pairs = zip(self.times, self.values, strict=True)
        return np.array([[np.exp(-2j * np.pi * frequency * t) @ (v - v.mean())] for t, v in pairs])

    def share(self, sums: Complex[np.ndarray, "M F"], in_step: bool) -> Float[np.ndarray, "F"]:
        """Share of the power that one sine explains: of one phase in all motions, or of a phase in each."""
        rows = np.array([len(t) for t in self.times])
        explained = abs(sums.sum(axis=0)) ** 2 / rows.sum() if in_step else (abs(sums) ** 2 / rows[:, None]).sum(axis=0)
        return 2.0 * explained / self.power


def frequencies_in_step(problem: Problem, fit: Fit, joint: str) -> list[float]:
    """Frequencies [Hz] at which what is left on a joint swings in one phase in all motions, and no command does; best first."""
    return [one.frequency for one in _peaks(problem, fit, joint, in_step=True)]


def main_swing(problem: Problem, fit: Fit, joint: str) -> Swing | None:
    """The one frequency at which most of what is left on a joint swings, where that is so and no command does."""
    found = _peaks(problem, fit, joint, in_step=False)
    return found[0] if found and found[0].share > MAINLY else None


def _peaks(problem: Problem, fit: Fit, joint: str, in_step: bool) -> list[Swing]:
    left, told = _left(problem, fit, joint), _told(fit)
    if not left.times:
        return []
    longest = max(float(t[-1] - t[0]) for t in left.times)
    step = min(float(np.median(np.diff(t))) for t in left.times)
    length = FINE * (round(longest / step) + 1)
    frequencies = np.fft.rfftfreq(length, step)
    shares = left.share(left.spectra(step, length), in_step)
    inside = (frequencies > max(LOWEST, TURNS / longest)) & (frequencies < min(HIGHEST, 0.4 / step))
    tops = [i for i in find_peaks(shares, distance=FINE)[0] if inside[i]]
    found = []
    for top in sorted(tops, key=lambda i: -shares[i])[:MOST]:
        before, here, after = shares[top - 1 : top + 2]
        frequency = float(frequencies[top] + 0.5 * frequencies[1] * (before - after) / (before - 2.0 * here + after))
        own = Swing(frequency, float(left.share(left.at(frequency), in_step)[0]))
        if own.share > CLEARER * max(float(one.share(one.at(frequency), in_step)[0]) for one in told):
            found.append(own)
    return found


def _left(problem: Problem, fit: Fit, joint: str) -> _Series:
    """What a model leaves of a joint's angle [rad] in each fitted motion of more than two rows."""
    objective, column = fit.objective, problem.joints.index(joint)
    clocks = [w.episode.times[w.first : w.last + 1][1 :: objective.stride] - w.episode.times[0] for w in objective.windows]
    parts = [part[:, column] for part in objective.per_window(fit.residual)]
    long = [k for k, clock in enumerate(clocks) if len(clock) > 2]
    return _Series([clocks[k] for k in long], [parts[k] for k in long])


def _told(fit: Fit) -> list[_Series]:
    """The commands [rad, or what an actuator takes] of each joint in the fitted motions, J of them."""
    parts = []
    for w in fit.objective.windows:
        clock = w.episode.times[w.first : w.last + 1]
        parts.append((clock - w.episode.times[0], w.episode.command[w.episode.in_force(clock)]))
    return [_Series([t for t, _ in parts], [c[:, j] for _, c in parts]) for j in range(parts[0][1].shape[1])]
