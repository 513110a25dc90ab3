"""A recording format: how one sort of file is recognised, read and, where it can be, written."""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from edream.core.episode import Recording
from edream.core.errors import EdreamError


@dataclass(frozen=True)
class ReadOptions:
    """What a file cannot say about itself.

    Attributes:
        fps: rate [Hz] for formats without a time base, or None.
        time: name of the time column of a plain table.
        command: names of the commanded columns of a plain table.
        position: names of the measured columns of a plain table.
        colour: channel order of raw images on disk, "rgb" or "bgr".
        command_shift: rows by which commands are to be moved later in time (1 where a recorder stored the next action).
    """

    fps: float | None = None
    time: str | None = None
    command: tuple[str, ...] = ()
    position: tuple[str, ...] = ()
    colour: str = "rgb"
    command_shift: int = 0


@dataclass(frozen=True)
class Malformed:
    """One recording that could not be read: its name and, in one sentence, what is wrong with it."""

    name: str
    reason: str


class Format(ABC):
    """One recording format. A new one is one new file in `edream/formats/` that defines `ENTRY`."""

    name: str
    summary: str

    @abstractmethod
    def recognise(self, path: Path) -> str | None:
        """Why `path` holds data in this format, from its content and never from its name alone; None where it does not."""

    @abstractmethod
    def recordings(self, path: Path, options: ReadOptions) -> Iterator[Recording | Malformed]:
        """Read the recordings one by one, in an order that depends on the data alone.

        A recording that is malformed is yielded as `Malformed`; reading goes on with the next.

        Raises:
            EdreamError: nothing can be read at all, or an option that this format needs is missing.
        """

    def write(self, recordings: Iterable[Recording], path: Path) -> None:
        """Write recordings into the new folder `path`.

        Raises:
            EdreamError: this format is read only, or `path` exists.
        """
        raise EdreamError(f"Format {self.name!r} is read only; nothing was written to {path}. Use lerobot_v3 or aloha_hdf5.")
