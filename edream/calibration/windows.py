"""Simulated windows as equal-length sequences of states and commands: what a sweep makes and a surrogate learns from."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from edream.core.episode import Episode
from edream.sim.rollout import rollout
from edream.sim.simulation import SimulatedRobot
from edream.sim.start import start_velocity
from edream.sim.window import Window


@dataclass(frozen=True, eq=False)
class Sequences:
    """N windows of T rows each.

    Attributes:
        unit: the parameters as a point of the unit box, (N, P).
        factors: natural logarithm of the known factors of scaled parameters, (N, C).
        position: joint positions [rad], (N, T, J).
        velocity: joint velocities [rad/s], (N, T, J).
        command: command in force from each row on [rad], (N, T, J).
        dt: time from each row to the next [s], (N, T); the last is not used.
        enabled: whether torque is on from each row on, as 0 or 1, (N, T).
        which: number of the parameter set and of the window, (N, 2).
    """

    unit: Float[np.ndarray, "N P"]
    factors: Float[np.ndarray, "N C"]
    position: Float[np.ndarray, "N T J"]
    velocity: Float[np.ndarray, "N T J"]
    command: Float[np.ndarray, "N T J"]
    dt: Float[np.ndarray, "N T"]
    enabled: Float[np.ndarray, "N T"]
    which: Int[np.ndarray, "N 2"]

    def __len__(self) -> int:
        return len(self.unit)

    def take(self, rows: np.ndarray) -> "Sequences":
        """Some of the windows."""
        return Sequences(*(getattr(self, name)[rows] for name in self.__dataclass_fields__))

    def with_unit(self, unit: Float[np.ndarray, "N P"]) -> "Sequences":
        return replace(self, unit=unit)


def join(parts: Sequence[Sequences]) -> Sequences:
    """Sequences one after the other."""
    return Sequences(*(np.concatenate([getattr(part, name) for part in parts]) for name in Sequences.__dataclass_fields__))


def draw_windows(episodes: Sequence[Episode], rows: int, count: int, rng: np.random.Generator) -> list[Window]:
    """Windows of `rows` measurements each, spread evenly over all motions with a random offset.

    A motion that is shorter than a window is left out.
    """
    starts = [(episode, first) for episode in episodes for first in range(0, len(episode.times) - rows, max(1, rows // 2))]
    if not starts:
        return []
    step = max(1.0, len(starts) / count)
    chosen = (np.arange(min(count, len(starts))) * step + rng.uniform(0, step)).astype(int) % len(starts)
    return [Window(starts[i][0], starts[i][1], starts[i][1] + rows - 1) for i in sorted(set(chosen.tolist()))]


def measured_sequences(simulated: SimulatedRobot, windows: Sequence[Window]) -> Sequences:
    """The recordings themselves in the form of a sweep: measured positions, and velocities from them."""
    position = np.stack([w.measured for w in windows])
    velocity = np.stack([np.gradient(w.measured, w.times, axis=0) for w in windows])
    velocity[:, 0] = np.stack([start_velocity(w) for w in windows])
    unit = np.zeros((len(windows), len(simulated.space)))
    which = np.stack([np.full(len(windows), -1), np.arange(len(windows))], axis=1)
    return Sequences(unit, log_factors(simulated, windows), position, velocity, *_commands(windows), which)


def simulate(simulated: SimulatedRobot, unit: Float[np.ndarray, "N P"], windows: Sequence[Window], threads: int = 0) -> Sequences:
    """Simulate every parameter set on every window; simulations that blow up are left out.

    Velocities come from two samples one simulation step apart, which is what the integrator itself means by velocity.

    Args:
        unit: parameter sets in the unit box.
        windows: windows of equal length.
    """
    step = float(simulated.model.opt.timestep)
    dense = [_with_velocity_samples(window, step) for window in windows]
    results = rollout(simulated, simulated.space.from_unit(unit), dense, threads)
    parts = [_sequences(simulated, unit, i, *one) for i, one in enumerate(zip(windows, dense, results, strict=True))]
    made = join(parts)
    return made.take(np.flatnonzero(np.isfinite(made.position).all(axis=(1, 2))))


def _sequences(
    simulated: SimulatedRobot, unit: np.ndarray, number: int, window: Window, dense: Window, result: np.ndarray
) -> Sequences:
    n = len(unit)
    spans = np.diff(dense.times)[1::2, None]
    first = np.broadcast_to(start_velocity(window), (n, 1, result.shape[2]))
    velocity = np.concatenate([first, (result[:, 2::2] - result[:, 1::2]) / spans], axis=1)
    shared = [np.repeat(part, n, axis=0) for part in (log_factors(simulated, [window]), *_commands([window]))]
    which = np.stack([np.arange(n), np.full(n, number)], axis=1)
    factors, command, dt, enabled = shared
    return Sequences(unit, factors, result[:, 0::2], velocity, command, dt, enabled, which)


def _with_velocity_samples(window: Window, step: float) -> Window:
    """The same stretch, sampled one simulation step before each measurement too."""
    episode = window.episode
    at = episode.times[window.first : window.last + 1]
    before = np.maximum(at[1:] - step, (at[:-1] + at[1:]) / 2)
    times = np.empty(2 * len(at) - 1)
    times[0::2], times[1::2] = at, before
    line = window.measured[0] + (times - times[0])[:, None] * start_velocity(window)
    return Window(replace(episode, times=times, position=line, velocity=None, effort=None, videos={}), 0, len(times) - 1)


def log_factors(simulated: SimulatedRobot, windows: Sequence[Window]) -> Float[np.ndarray, "W C"]:
    """Logarithm of each condition's factor in each window; one column for each condition that scales anything."""
    every = {(s.condition, s.reference): s for p in simulated.placements for s in (p.scaled or {}).values()}
    rows = [[np.log(max(every[key].factor(w.episode.conditions), 1e-6)) for key in sorted(every)] for w in windows]
    return np.array(rows, dtype=float).reshape(len(windows), len(every))


def _commands(windows: Sequence[Window]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Commands in force from each measurement on, time to the next measurement, and whether torque is on."""
    command, dt, enabled = [], [], []
    for window in windows:
        episode = window.episode
        clock = episode.times[window.first : window.last + 1]
        rows = episode.in_force(clock)
        command.append(episode.command[rows])
        dt.append(np.append(np.diff(clock), 0.0))
        enabled.append(np.ones(len(rows)) if episode.enabled is None else episode.enabled[rows].astype(float))
    return np.stack(command), np.stack(dt), np.stack(enabled)
