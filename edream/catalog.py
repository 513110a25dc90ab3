"""A folder is a catalog: every file in it defines `ENTRY`, named like the file."""

import importlib
import pkgutil
from functools import cache
from typing import TypeVar

from edream.core.errors import unknown_name

T = TypeVar("T")


@cache
def names(folder: str) -> tuple[str, ...]:
    """Names of the entries of `edream/<folder>/`, sorted, without importing any.

    Args:
        folder: a catalog folder, such as "effects" or "formats".
    """
    package = importlib.import_module(f"edream.{folder}")
    return tuple(sorted(module.name for module in pkgutil.iter_modules(package.__path__) if not module.name.startswith("_")))


def load(folder: str, name: str, kind: type[T]) -> T:
    """Import one entry.

    Args:
        folder: the catalog folder.
        name: the entry's name, which is its file's name.
        kind: the class that the entry must be an instance of.

    Raises:
        EdreamError: there is no such entry.
        TypeError: the file breaks the catalog's rule (a bug, not a user's mistake).
    """
    if name not in names(folder):
        one = f"{folder[:-3]}y" if folder.endswith("ies") else folder.rstrip("s")
        raise unknown_name(one, name, names(folder))
    entry = importlib.import_module(f"edream.{folder}.{name}").ENTRY
    if not isinstance(entry, kind) or getattr(entry, "name", None) != name:
        raise TypeError(f"edream/{folder}/{name}.py: ENTRY must be a {kind.__name__} whose name is {name!r}, not {entry!r}")
    return entry
