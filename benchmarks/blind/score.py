"""Phase 3: the truth is opened and a diagnosis is held against it."""

from collections.abc import Mapping, Sequence
from typing import Any

import mujoco

from benchmarks.blind.cases import Case
from benchmarks.blind.names import is_usual, library_name, true_targets, true_values
from edream.reality.truth import Truth

CLOSE = 0.10  # a value this near to the truth counts, as does one inside its interval
MEANT = 0.15  # where the truth is nearly nothing, the largest true value of the effect is the yardstick
REDUCED = 0.9  # an unnamed gap counts as reduced where at most this share of it is left


def label(name: str, targets: Sequence[str]) -> str:
    """An effect at its place, as diagnosis writes it among the confusable ones."""
    return f"{name}[{'+'.join(targets)}]" if targets else name


def score(case: Case, truth: Truth, model: mujoco.MjModel, result: Mapping[str, Any]) -> dict[str, Any]:
    """One row of the table.

    `found` lists for each hidden effect "named", "told" (not named, but a named one is said to be confusable with it, and the
    verdict is `cannot_tell`) or "missed"; one named effect stands for one hidden effect. `right` is the answer asked for: every
    hidden effect found and nothing else named; nothing named where nothing is hidden; `unnamed` with less gap outside the library.
    """
    row: dict[str, Any] = {
        "case": case.name,
        "sort": case.sort,
        "robot": case.robot,
        "hidden": [label(h.name, h.targets) for h in truth.effects],
        "verdict": result["verdict"],
        "named": [label(e["name"], e["targets"]) for e in result["effects"]],
        "seconds": result["seconds"],
        "gap": result["gap"],
        "closed": closed(result["gap"]),
        "closed_square": closed({key: value**2 for key, value in result["gap"].items()}),
    }
    if case.sort == "none":
        return row | {"right": result["verdict"] == "none" and not result["effects"]}
    if case.sort == "foreign":
        gap = result["gap"]
        return row | {"right": result["verdict"] == "unnamed" and gap["after_rad"] < REDUCED * gap["before_rad"]}
    row["usual"] = all(is_usual(h, truth, model) for h in truth.effects)
    expected = [(library_name(h.name), true_targets(h, model)) for h in truth.effects]
    found = _found(expected, result)
    row["expected"] = [label(name, targets) for name, targets in expected]
    row["found"] = [how for how, _ in found]
    row["extra"] = [label(e["name"], e["targets"]) for e in result["effects"] if id(e) not in {id(by) for _, by in found}]
    row["values"] = [
        value_error(quantity, true, by)
        for hidden, (how, by) in zip(truth.effects, found, strict=True)
        if how == "named" and by is not None
        for quantity, true in _yardsticks(true_values(hidden, truth, model)).items()
        if quantity in by["values"]
    ]
    row["right"] = "missed" not in row["found"] and not row["extra"] and result["verdict"] != "unnamed"
    return row


def is_resolved(row: Mapping[str, Any]) -> bool:
    """Whether a diagnosis with the suggested motion names every hidden effect and nothing else, without a doubt."""
    return row["verdict"] == "named" and set(row.get("found", [])) == {"named"} and not row["extra"]


def is_shown(row: Mapping[str, Any]) -> bool:
    """Whether what is hidden changes the motion by more than the encoder's noise, so that anybody could see it."""
    return "shown_rad" not in row or row["shown_rad"] > row["gap"]["noise_floor_rad"]


def closed(gap: Mapping[str, float]) -> float | None:
    """Share of the gap above the noise floor that is closed on motions never fitted; None where there was no gap."""
    opened = gap["before_rad"] - gap["noise_floor_rad"]
    return (gap["before_rad"] - gap["after_rad"]) / opened if opened > 0.0 else None


def _found(expected: Sequence[tuple[str, Sequence[str]]], result: Mapping[str, Any]) -> list[tuple[str, Any]]:
    """How each hidden effect was found, and by which named one."""
    out: list[tuple[str, Any]] = [("missed", None)] * len(expected)
    left = list(result["effects"])
    for number, (name, targets) in enumerate(expected):
        own = next((e for e in left if e["name"] == name and set(e["targets"]) == set(targets)), None)
        if own is not None:
            out[number] = "named", own
            left.remove(own)
    for number, (name, targets) in enumerate(expected):
        doubted = [e for e in left if result["verdict"] == "cannot_tell" and label(name, targets) in e["confusable_with"]]
        if out[number][0] == "missed" and doubted:
            out[number] = "told", doubted[0]
            left.remove(doubted[0])
    return out


def _yardsticks(values: Mapping[str, float]) -> dict[str, tuple[float, float]]:
    """Each true value with the size that its error is measured by: its own, or where it is near zero that of its companions."""
    largest = max((abs(v) for v in values.values()), default=0.0)
    return {name: (value, max(abs(value), MEANT * largest, 1e-9)) for name, value in values.items()}


def value_error(quantity: str, true: tuple[float, float], effect: Mapping[str, Any]) -> dict[str, Any]:
    """How far one value is from the truth, and whether it counts as right."""
    value, (low, high) = effect["values"][quantity], effect["intervals"][quantity]
    relative = abs(value - true[0]) / true[1]
    inside = low <= true[0] <= high
    return {
        "quantity": f"{effect['name']}.{quantity}",
        "true": true[0],
        "found": value,
        "relative": relative,
        "inside": inside,
        "right": inside or relative <= CLOSE,
    }
