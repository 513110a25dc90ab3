"""Which motions are kept back for the proof, and never fitted."""

from collections.abc import Sequence
from fnmatch import fnmatchcase

import numpy as np
from jaxtyping import Bool, Float

from edream.core.errors import EdreamError, unknown_name
from edream.sim.window import Window

HARD = 99.0  # percentile of what is asked of a joint in a motion
OUTSTANDING = 1.2  # times the most that is asked of it in those that are fitted
LEFT = 3  # motions at least are fitted


def named(windows: Sequence[Window], patterns: Sequence[str]) -> set[str]:
    """The motions with these names or patterns.

    Raises:
        EdreamError: a pattern meets none, or they leave too few.
    """
    names = [window.episode.name for window in windows]
    for pattern in patterns:
        if not any(fnmatchcase(name, pattern) for name in names):
            raise unknown_name("motion for diagnose.holdout", pattern, names)
    kept = {name for name in names if any(fnmatchcase(name, pattern) for pattern in patterns)}
    if len(names) - len(kept) < LEFT:
        raise EdreamError(
            f"diagnose.holdout keeps {len(kept)} of {len(names)} motions; expected at least {LEFT} to be left to fit."
        )
    return kept


def drawn(windows: Sequence[Window], counted: Bool[np.ndarray, "J"], share: float, seed: int) -> set[str]:
    """A share of the motions, drawn by seed among those that ask no more of any joint than what is fitted does.

    What a robot does at its limits shows in few motions, and nobody learns it from the others: one that is driven harder than all
    the rest is fitted. That looks at commands and measurements alone, before anything is simulated.

    Args:
        windows: the motions.
        counted: which joints count, (J,).
        share: of the motions; at least one is kept.
        seed: of the draw.
    """
    ordered = sorted(windows, key=lambda window: window.episode.name)
    count = min(max(1, round(share * len(ordered))), len(ordered) - LEFT)
    asked = np.array([_asked(window)[:, counted].ravel() for window in ordered])
    order = np.random.default_rng([seed, 7]).permutation(len(ordered)).tolist()
    kept: list[int] = []
    for number in order:
        if len(kept) < count and _over(asked, number, kept) <= OUTSTANDING:
            kept.append(number)
    others = sorted((number for number in order if number not in kept), key=lambda number: _over(asked, number, kept))
    kept += others[: count - len(kept)]  # where all stand out, those that do least
    return {ordered[number].episode.name for number in kept}


def _over(asked: Float[np.ndarray, "M Q"], number: int, kept: Sequence[int]) -> float:
    """How many times the most that is asked in the motions that are left without one and those kept is asked in that one."""
    rest = np.delete(asked, [number, *kept], axis=0).max(axis=0)
    return float((asked[number] / np.maximum(rest, 1e-12)).max())


def _asked(window: Window) -> Float[np.ndarray, "2 J"]:
    """How far commands are ahead of each joint [rad], by which its servo pulls, and how fast it is [rad/s], (2, J)."""
    episode, rows = window.episode, slice(window.first, window.last + 1)
    ahead = episode.command[episode.in_force(episode.times[rows])] - window.measured
    speed = np.diff(window.measured, axis=0) / np.diff(window.times)[:, None]
    return np.array([np.percentile(np.abs(one), HARD, axis=0) for one in (ahead, speed)])
