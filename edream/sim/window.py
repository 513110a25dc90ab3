"""A stretch of a recording that is replayed."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from edream.core.episode import Episode


@dataclass(frozen=True, eq=False)
class Window:
    """A stretch of an episode that is replayed open loop from its first measured state.

    Attributes:
        episode: the recorded motion.
        first, last: rows of the first and last measurement used (last included).
    """

    episode: Episode
    first: int
    last: int

    @property
    def times(self) -> Float[np.ndarray, "T"]:
        """Measurement times from the window's start [s]; the first is 0."""
        return self.episode.times[self.first : self.last + 1] - self.episode.times[self.first]

    @property
    def measured(self) -> Float[np.ndarray, "T J"]:
        """Measured positions [rad]; row 0 is where the simulation starts."""
        return self.episode.position[self.first : self.last + 1]


def whole(episodes: Sequence[Episode], until: float | None = None) -> list[Window]:
    """Every episode as one window, cut after `until` seconds."""
    return [Window(e, 0, len(e.times) - 1 if until is None else max(1, _row_at(e, e.times[0] + until))) for e in episodes]


def split(episodes: Sequence[Episode], seconds: float, until: float | None = None) -> list[Window]:
    """Every episode cut into consecutive windows of about `seconds`, each restarting at a measured state."""
    windows = []
    for window in whole(episodes, until):
        episode = window.episode
        start, end = episode.times[0], episode.times[window.last]
        count = max(1, round((end - start) / seconds))
        rows = [_row_at(episode, start + (end - start) * i / count) for i in range(count)] + [window.last]
        windows += [Window(episode, a, b) for a, b in pairwise(rows) if b > a]
    return windows


def at_rest(episodes: Sequence[Episode], count: int, until: float | None = None) -> list[Window]:
    """Long episodes cut into about `count` windows in all of about one length, at moments when little moves.

    Each window has an episode of a name of its own, with its seconds; what was commanded and measured before stays known to it. A
    window ends after `until` seconds [s], if given.
    """
    length = sum(episode.duration for episode in episodes) / count
    windows = []
    for episode in episodes:
        parts = max(1, round(episode.duration / length))
        speed = _relative_speed(episode)
        room = episode.duration / parts / 4.0
        rows = [0, len(episode.times) - 1]
        for end in (episode.times[0] + episode.duration * i / parts for i in range(1, parts)):
            first, last = _row_at(episode, end - room), _row_at(episode, end + room)
            rows.insert(-1, first + int(np.argmin(speed[first : last + 1])))
        for first, last in pairwise(rows):
            ends = last if until is None else min(last, _row_at(episode, episode.times[first] + until))
            name = f"{episode.name} {episode.times[first]:.1f} to {episode.times[ends]:.1f} s"
            windows.append(Window(replace(episode, name=name), first, ends))
    return windows


def _relative_speed(episode: Episode) -> Float[np.ndarray, "T"]:
    """How fast the joints are at each measurement, each for what it does in the whole episode, summed; needs two measurements."""
    if len(episode.times) < 2:
        return np.zeros(len(episode.times))
    speed = np.abs(np.gradient(episode.position, episode.times, axis=0))
    return (speed / np.maximum(speed.mean(axis=0), 1e-9)).sum(axis=1)


def _row_at(episode: Episode, time: float) -> int:
    return int(np.clip(np.searchsorted(episode.times, time, side="right") - 1, 0, len(episode.times) - 1))
