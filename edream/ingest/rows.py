"""What writers of row-by-row formats share."""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from edream.core.episode import Recording
from edream.core.errors import EdreamError


def held_commands(recording: Recording) -> Float[np.ndarray, "T D"]:
    """The command in force at each measurement; exactly the commands where both share one clock.

    Raises:
        EdreamError: there are no commands.
    """
    if len(recording.command) == 0:
        raise EdreamError(f"Recording {recording.name!r} holds no commands; this format needs one a row.")
    if np.array_equal(recording.command_times, recording.times):
        return recording.command
    row = np.searchsorted(recording.command_times, recording.times, side="right") - 1
    return recording.command[np.maximum(row, 0)]


def new_folder(path: Path) -> None:
    """Make the folder that a data set is written into.

    Raises:
        EdreamError: it exists and is not empty, or cannot be made.
    """
    if path.exists() and (not path.is_dir() or any(path.iterdir())):
        raise EdreamError(f"{path} exists already; a data set is never written over another.")
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise EdreamError(f"The folder {path} cannot be made: {error.strerror}.") from error
