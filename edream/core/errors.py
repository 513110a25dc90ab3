"""The one exception that a user is meant to read."""

from collections.abc import Iterable
from difflib import get_close_matches


class EdreamError(Exception):
    """Something a user can mend: what is wrong, where, what was expected and what exists.

    The command line prints the message and exits with 2; every other exception is a bug of ours and shows its traceback.
    """


def unknown_name(what: str, name: str, known: Iterable[str]) -> EdreamError:
    """An `EdreamError` for a name that does not exist, with the nearest names that do.

    Args:
        what: the sort of thing looked for, such as "joint".
        name: the name that was not found.
        known: every name that exists.
    """
    known = sorted(known)
    near = get_close_matches(name, known, n=1)
    hint = f" Did you mean {near[0]!r}?" if near else ""
    listed = ", ".join(known) if known else "none"
    return EdreamError(f"There is no {what} {name!r}.{hint} What exists: {listed}.")


def require(good: bool, name: str, value: object, expected: str) -> None:
    """Refuse a setting that is out of its range.

    Raises:
        EdreamError: naming the setting, its value and what was expected.
    """
    if not good:
        raise EdreamError(f"{name} is {value}; expected {expected}.")
