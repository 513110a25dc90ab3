"""Whether measurements answer commands before these can have acted: a recorder that read the robot after its step, not before."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from edream.core.episode import Episode

PAST = 4  # rows that foretell the next one
FEWEST = 100  # rows that say something
TOGETHER = 0.1  # of a step: measurements and commands so near each other share a row
MISSED = 1.1  # times the error of the forecast without a row's own command: far more than chance, noise and friction make of it


def answering_early(episodes: Sequence[Episode]) -> tuple[str, ...]:
    """Joints whose measurement answers a command in its own row.

    Each measurement is foretold from the four before it and the commands held at those, once with the command of its own row and
    once without. A command that is given when the robot is read says nothing of where it stands, beside those. Source: Granger,
    Econometrica 37(3), 1969. Nothing is said of recordings whose commands have a clock of their own.
    """
    known = [one for one in episodes if _share_rows(one)]
    joints = episodes[0].joints if episodes else ()
    return tuple(joint for column, joint in enumerate(joints) if _missed(known, column) > MISSED)


def warning(joints: Sequence[str]) -> str:
    """What to say of such joints, if any."""
    if not joints:
        return ""
    return (
        f"Measurements of {', '.join(joints)} answer the command of their own row, before it can have acted: was the robot read "
        "after each step? ingest.command_shift=-1 puts that right."
    )


def beware(episodes: Sequence[Episode]) -> str:
    """The warning about some recordings, to be said after a sentence."""
    said = warning(answering_early(episodes))
    return f" {said}" if said else ""


def _share_rows(episode: Episode) -> bool:
    if len(episode.times) < 2 or len(episode.command_times) < 2:
        return False
    step = float(np.median(np.diff(episode.times)))
    later = np.searchsorted(episode.command_times, episode.times).clip(1, len(episode.command_times) - 1)
    nearest = np.minimum(
        np.abs(episode.times - episode.command_times[later]), np.abs(episode.times - episode.command_times[later - 1])
    )
    return bool(np.median(nearest) < TOGETHER * step)


def _missed(episodes: Sequence[Episode], column: int) -> float:
    """How many times as wrong the forecast of a joint is without the command of the same row; 1 where nothing can be said."""
    rows = [_rows(one, column) for one in episodes if len(one.times) > PAST]
    past, position = (np.concatenate(parts) for parts in zip(*rows, strict=True)) if rows else (np.zeros((0, 1)), np.zeros(0))
    if len(position) < FEWEST or np.ptp(position) == 0.0:
        return 1.0
    errors = [np.linalg.norm(position - some @ np.linalg.lstsq(some, position, rcond=None)[0]) for some in (past, past[:, 1:])]
    return float(errors[1] / errors[0]) if errors[0] > 0.0 else 1.0


def _rows(episode: Episode, column: int) -> tuple[Float[np.ndarray, "R F"], Float[np.ndarray, "R"]]:
    """The command of each row, what foretells the row otherwise, and its position [rad or m]."""
    step = float(np.median(np.diff(episode.times)))
    held = np.searchsorted(episode.command_times, episode.times + TOGETHER * step, side="right") - 1
    command, position = episode.command[held.clip(0), column], episode.position[:, column]
    here = np.arange(PAST, len(position))
    before = [values[here - age] for age in range(1, PAST + 1) for values in (position, command)]
    return np.stack([command[here], *before, np.ones(len(here))], axis=1), position[here]
