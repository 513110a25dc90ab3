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


def at_rest(episodes: Sequence[Episode], count: int) -> list[Window]:
    """Long episodes cut into `count` windows in all of about one length, at moments when little moves.

    Each window has an episode of a name of its own, with its seconds; what was commanded and measured before stays known to it.
    """
    length = sum(episode.duration for episode in episodes) / count
    windows = []
    for episode in episodes:
        parts = max(1, round(episode.duration / length))
        ends = [episode.times[0] + episode.duration * i / parts for i in range(1, parts)]
        rows = [0, *(_quietest(episode, end, episode.duration / parts / 4.0) for end in ends), len(episode.times) - 1]
        for first, last in pairwise(rows):
            name = f"{episode.name} {episode.times[first]:.1f} to {episode.times[last]:.1f} s"
            windows.append(Window(replace(episode, name=name), first, last))
    return windows


def _quietest(episode: Episode, time: float, room: float) -> int:
    """The row around a time, at most `room` seconds away, where the joints are slowest for what they do in the whole episode."""
    first, last = _row_at(episode, time - room), _row_at(episode, time + room)
    speed = np.abs(np.gradient(episode.position, episode.times, axis=0))
    return first + int(np.argmin((speed / np.maximum(speed.mean(axis=0), 1e-9)).sum(axis=1)[first : last + 1]))


def _row_at(episode: Episode, time: float) -> int:
    return int(np.clip(np.searchsorted(episode.times, time, side="right") - 1, 0, len(episode.times) - 1))
