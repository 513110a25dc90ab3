"""Blindfold: a process that puts it on can neither import the make-believe robot nor open a truth."""

import itertools
import sys
from pathlib import PurePath

HIDDEN_PACKAGE = "edream.reality"


class PeekError(PermissionError):
    """A blindfolded process tried to see the truth."""


def blindfold() -> None:
    """Refuse, for the rest of this process, to import `edream.reality` or to open a sealed truth.

    It cannot be taken off again (`sys.addaudithook`).

    Raises:
        PeekError: the package was imported before.
    """
    if seen := [name for name in sys.modules if name.startswith(HIDDEN_PACKAGE)]:
        raise PeekError(f"{seen[0]} was imported before the blindfold was put on")
    sys.addaudithook(_refuse)


def _refuse(event: str, arguments: tuple[object, ...]) -> None:
    if event == "import" and str(arguments[0]).startswith(HIDDEN_PACKAGE):
        raise PeekError(f"a diagnosis may not import {arguments[0]}")
    if event == "open" and is_hidden(str(arguments[0])):
        raise PeekError(f"a diagnosis may not open {arguments[0]}")


def is_hidden(path: str) -> bool:
    """Whether a path is that of a sealed truth (named as such, or in a folder of truths) or of the make-believe robot's code."""
    parts = PurePath(path).parts
    return path.endswith(".truth.json") or "truth" in parts or ("edream", "reality") in itertools.pairwise(parts)
