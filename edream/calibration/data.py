"""The stretches of motions that a fit replays."""

from collections.abc import Sequence

import numpy as np

from edream.core.episode import Episode
from edream.sim.window import Window, split


def stretches(episodes: Sequence[Episode], seconds: float, total: float, until: float | None) -> list[Window]:
    """Stretches of about `seconds` from every motion, evenly spread, that last about `total` seconds together.

    Each restarts at a measured state. With more motions than stretches, motions are skipped evenly.
    """
    return thinned(split(episodes, seconds, until), total)


def thinned(windows: Sequence[Window], total: float) -> list[Window]:
    """As many windows, evenly spread, as last about `total` seconds together; all where they last no longer."""
    lengths = np.array([window.times[-1] for window in windows])
    wanted = max(1, round(len(windows) * min(1.0, total / lengths.sum())))
    return [windows[i] for i in sorted(set(np.linspace(0, len(windows) - 1, wanted).round().astype(int).tolist()))]


def sampling_stride(episodes: Sequence[Episode], rate: float) -> int:
    """Every how many measurements one is enough for `rate` samples a second."""
    interval = float(np.median(np.concatenate([np.diff(episode.times) for episode in episodes])))
    return max(1, int(1.0 / (rate * interval)))


def rows_in(episodes: Sequence[Episode], seconds: float, most: int) -> int:
    """Measurements that last about `seconds`, at least 6 and at most `most`, and no more than the shortest motions have."""
    interval = float(np.median(np.concatenate([np.diff(episode.times) for episode in episodes])))
    shortest = int(np.median([len(episode.times) for episode in episodes]))
    return max(6, min(most, round(seconds / interval) + 1, shortest - 1))
