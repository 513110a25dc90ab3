"""What a command prints: one JSON object, or short tables for a person."""

import json as json_
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from edream.calibration.methods import methods
from edream.store import StoredArtifact

SUMMARY = "summary.json"
MOST = 40
WIDE = 160  # columns where nobody says how many there are
FIRST = ("name", "model", "value", "unit", "interval", "status")  # columns that a reader looks for, in this order
RATE = {"successes", "trials", "share", "interval"}  # how often something succeeded, with Wilson's interval
BOX = {"low", "high", "start"}  # what --json adds to a parameter


def result(made: Mapping[str, StoredArtifact], run: Path, write: Callable[[str], object] | None) -> None:
    """Print what a command made.

    The summary of the first artifact that has a `summary.json` is printed; a value in it that is the name of a file of that
    artifact becomes the file's path. Further artifacts add the path of their first `.html` under their stage's name.

    Args:
        made: the artifacts asked for, in order, then all that they were made from; those under other settings by their needs.
        run: the file that names them.
        write: prints the JSON object, or None to print tables.
    """
    first = next(iter(made.values()))
    summary = {name: _as_path(first, value) for name, value in first[SUMMARY].items()} if SUMMARY in first else {}
    for name, artifact in made.items():
        pages = [file for file in artifact if file.endswith(".html")]
        if pages:
            summary.setdefault(name if artifact is not first else "report", str(artifact.path(pages[0]).absolute()))
    own = [artifact for need, artifact in made.items() if need == artifact.stage]
    summary.setdefault("seconds", round(sum(artifact.seconds for artifact in own), 1))
    beside = methods(made)
    summary |= {"methods": beside} if beside else {}
    summary |= {"artifact": str(first.folder.absolute()), "run": str(run.absolute())}
    if write is not None:
        write(json_.dumps(summary, indent=2, allow_nan=False))
    else:
        table(summary)


def table(values: Mapping[str, Any]) -> None:
    """Print a mapping for a person: sentences first, then single values, then a table for each list or mapping."""
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    console = Console(highlight=False, soft_wrap=True, width=None if sys.stdout.isatty() else WIDE)
    if "sentence" in values:
        console.print(str(values["sentence"]), style="bold", markup=False)
    for name, value in values.items():
        if name != "sentence" and not isinstance(value, Mapping | list | tuple):
            console.print(f"{name:<14} {_cell(value)}", markup=False)
    for name, value in values.items():
        if isinstance(value, list | tuple) and value and not any(isinstance(item, Mapping) for item in value):
            short = all(len(_cell(item)) < 30 for item in value)
            console.print(
                f"{name:<14} {_cell(value)}" if short else "\n".join([name, *(f"  {_cell(item)}" for item in value)]), markup=False
            )
        elif isinstance(value, Mapping | list | tuple) and value:
            rows = _rows(value)
            shown = Table(title=name, title_justify="left", box=None, pad_edge=False)
            columns = _columns(rows)
            for column in columns:
                whole = all(isinstance(row.get(column), int | float) for row in rows if column in row)
                shown.add_column(escape(column), no_wrap=whole or column in ("value", "status", "unit"))
            for row in rows[:MOST]:
                shown.add_row(*(escape(_cell(row.get(column, ""))) for column in columns))
            console.print()
            console.print(shown)
            if len(rows) > MOST:
                console.print(f"... and {len(rows) - MOST} more", markup=False)


def _rows(value: Mapping[str, Any] | Sequence[Any]) -> list[dict[str, Any]]:
    items = [({"name": key}, item) for key, item in value.items()] if isinstance(value, Mapping) else [({}, item) for item in value]
    return [head | (dict(item) if isinstance(item, Mapping) else {"value": item}) for head, item in items]


def _columns(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """What a person is shown of rows, in the order of reading."""
    every = list(dict.fromkeys(column for row in rows for column in row))
    hidden = BOX if set(every) > BOX else set()
    shown = [
        c
        for c in every
        if c not in hidden
        and not any(_long(row.get(c)) for row in rows)
        and any(row.get(c) not in (None, "", [], ()) for row in rows)
    ]
    return sorted(shown, key=lambda column: FIRST.index(column) if column in FIRST else len(FIRST))


def _long(value: Any) -> bool:
    """Whether a value is no cell of a table; --json has it whole."""
    return isinstance(value, Mapping) and (len(value) > 4 or any(isinstance(item, Mapping) for item in value.values()))


def _cell(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.5g}"
    if isinstance(value, list | tuple):
        return ", ".join(_cell(item) for item in value)
    if isinstance(value, Mapping) and value.keys() == RATE:
        low, high = (100 * side for side in value["interval"])
        return f"{100 * value['share']:.1f} % [{low:.1f}, {high:.1f}], {value['successes']} of {value['trials']}"
    if isinstance(value, Mapping):
        return ", ".join(f"{name} {_cell(item)}" for name, item in value.items())
    return "-" if value is None else re.sub(r"\[([^\]+]+)(\+[^\]]+){2,}\]", _shortened, str(value))


def _shortened(found: re.Match) -> str:
    """`[a+b+c+d]`, the joints that share a number, as `[4 tied]`."""
    return f"[{found[0].count('+') + 1} tied]"


def _as_path(artifact: StoredArtifact, value: Any) -> Any:
    return str(artifact.path(value).absolute()) if isinstance(value, str) and value in artifact else value
