"""Scores of many cases as one table: the confusion matrix, accuracy by effect, and what the acceptance asks for."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from statistics import median
from typing import Any

from benchmarks.blind.names import library_name
from benchmarks.blind.score import is_shown
from edream.reality.effects import KINDS

BASELINES = ("all_free", "bic", "sparse", "mlp")
Row = Mapping[str, Any]


def table(rows: Sequence[Row], planned: int) -> dict[str, Any]:
    """Everything that is reported, from the scored rows."""
    by_sort = {sort: [r for r in rows if r["sort"] == sort] for sort in ("single", "pair", "none", "foreign")}
    named = [r for r in by_sort["single"] + by_sort["pair"] if r["right"]]
    values = [v for r in by_sort["single"] + by_sort["pair"] for v in r.get("values", [])]
    seconds = [r["seconds"] for r in rows if r["seconds"] is not None]
    return {
        "planned": planned,
        "done": len(rows),
        "versions": sorted({r["version"] for r in rows if "version" in r}),
        "single_right": share(r["right"] for r in by_sort["single"]),
        "single_visible_right": share(r["right"] for r in by_sort["single"] if not r["usual"]),
        "single_shown_right": share(r["right"] for r in by_sort["single"] if is_shown(r)),
        "single_found": share("missed" not in r["found"] for r in by_sort["single"]),
        "pair_right": share(r["right"] for r in by_sort["pair"]),
        "pair_found": share("missed" not in r["found"] for r in by_sort["pair"]),
        "false_alarm": share(not r["right"] for r in by_sort["none"]),
        "foreign_right": share(r["right"] for r in by_sort["foreign"]),
        "suggested": share(r["suggested"] for r in rows if "suggested" in r),
        "resolved": share(r["resolved"] for r in rows if "resolved" in r),
        "foreign_unnamed": share(r["verdict"] == "unnamed" for r in by_sort["foreign"]),
        "closed_90": share(r["closed"] is not None and r["closed"] >= 0.9 for r in named),
        "closed_square_90": share(r["closed_square"] is not None and r["closed_square"] >= 0.9 for r in named),
        "closed_median": _median(r["closed"] for r in named if r["closed"] is not None),
        "values_right": share(v["right"] for v in values),
        "value_error_median": _median(v["relative"] for v in values),
        "seconds_median": _median(seconds),
        "seconds_most": max(seconds, default=None),
        "verdicts": {sort: dict(Counter(r["verdict"] for r in some)) for sort, some in by_sort.items() if some},
        "effects": by_effect([*by_sort["single"], *by_sort["foreign"]]),
        "confusion": confusion([*by_sort["single"], *by_sort["none"], *by_sort["foreign"]]),
        "baselines": baselines(rows),
    }


def share(truths: Iterable[bool]) -> list[int]:
    """How many of how many."""
    listed = list(truths)
    return [sum(listed), len(listed)]


def _median(numbers: Iterable[float]) -> float | None:
    listed = list(numbers)
    return median(listed) if listed else None


def _effects(row: Row) -> list[str]:
    return [one.partition("[")[0] for one in row["hidden"]]


def by_effect(rows: Sequence[Row]) -> dict[str, dict[str, Any]]:
    """Accuracy of each effect hidden alone."""
    out = {}
    for name in dict.fromkeys(_effects(r)[0] for r in rows):
        own = [r for r in rows if _effects(r)[0] == name]
        values = [v for r in own for v in r.get("values", [])]
        out[name] = {
            "right": share(r["right"] for r in own),
            "found": share("missed" not in r["found"] for r in own) if "found" in own[0] else None,
            "closed": _median(r["closed"] for r in own if r["closed"] is not None),
            "value_error": _median(v["relative"] for v in values),
            "values_right": share(v["right"] for v in values),
            "seconds": _median(r["seconds"] for r in own if r["seconds"] is not None),
        }
    return out


def confusion(rows: Sequence[Row]) -> dict[str, dict[str, int]]:
    """Hidden effect (in the library's words) -> answer -> count; a name at the wrong joint carries a star."""
    out: dict[str, Counter[str]] = {}
    for row in rows:
        hidden = _effects(row)[0] if row["hidden"] else "nothing"
        if row["sort"] == "single":
            hidden = library_name(hidden)
        right_place = bool(row.get("found")) and row["found"][0] == "named"
        names = [one.partition("[")[0] for one in row["named"]]
        said = "+".join(n if n != hidden or right_place else n + "*" for n in names) or row["verdict"]
        said += " or others" if row["verdict"] == "cannot_tell" else ""
        said = f"unnamed ({said})" if row["verdict"] == "unnamed" and names else said
        out.setdefault(hidden, Counter())[said] += 1
    return {hidden: dict(counts.most_common()) for hidden, counts in out.items()}


def baselines(rows: Sequence[Row]) -> dict[str, dict[str, Any]]:
    """The same cases through simpler methods: names right where they name, gap closed where they predict."""
    out = {}
    done = [r for r in rows if r.get("baselines")]
    for method in BASELINES:
        own = [(r, r["baselines"][method]) for r in done if method in r["baselines"]]
        if not own:
            continue
        single = [(r, b) for r, b in own if r["sort"] == "single"]
        names = [b["named"] == _expected(r) for r, b in single if "named" in b]
        alarms = [b["named"] is not None for r, b in own if r["sort"] == "none" and "named" in b]
        out[method] = {
            "single_right": share(names),
            "false_alarm": share(alarms),
            "closed_median": _median(_closed(r, b) for r, b in single if _closed(r, b) is not None),
            "seconds_median": _median(b["seconds"] for _, b in own),
        }
    if done:
        single = [r for r in done if r["sort"] == "single"]
        out["edream"] = {
            "single_right": share(r["right"] for r in single),
            "false_alarm": share(not r["right"] for r in done if r["sort"] == "none"),
            "closed_median": _median(r["closed"] for r in single if r["closed"] is not None),
            "seconds_median": _median(r["seconds"] for r in done),
        }
    return out


def _expected(row: Row) -> str:
    return row["expected"][0]


def _closed(row: Row, baseline: Mapping[str, Any]) -> float | None:
    gap = row["gap"]
    opened = gap["before_rad"] - gap["noise_floor_rad"]
    after = baseline.get("after_rad")
    return None if after is None or opened <= 0.0 else (gap["before_rad"] - after) / opened


def markdown(made: Mapping[str, Any], rows: Sequence[Row]) -> str:
    """The table for people."""
    by = ", ".join(made["versions"]) or "nobody"
    lines = ["# Blind tests", "", f"{made['done']} of {made['planned']} cases, diagnosed by {by}.", ""]
    lines += ["| what | result | wanted |", "| --- | --- | --- |"]
    for title, key, wanted in (
        ("one effect: right name and joint, nothing else named", "single_right", ">= 90 %"),
        ("the same, less usual numbers that stay within 30 % of the published", "single_visible_right", ""),
        ("the same of those that change the motion by more than the encoder's noise", "single_shown_right", ""),
        ("one effect: right name and joint among the answers", "single_found", ">= 90 %"),
        ("two effects: both named, nothing else", "pair_right", ">= 75 %"),
        ("two effects: both among the answers", "pair_found", ">= 75 %"),
        ("in doubt: a motion suggested", "suggested", ""),
        ("in doubt: resolved by recording the suggested motion", "resolved", ">= 70 %"),
        ("no effect: false alarms", "false_alarm", "<= 5 %"),
        ("outside the library: unnamed, gap reduced", "foreign_right", ">= 80 %"),
        ("named rightly: 90 % of the gap (root mean square) above the noise floor closed", "closed_90", ">= 90 %"),
        ("the same of mean squares", "closed_square_90", ""),
        ("values within 10 % or inside their interval", "values_right", ">= 90 %"),
    ):
        lines.append(f"| {title} | {_share(made[key])} | {wanted} |")
    lines.append(f"| median gap closed, named rightly | {_number(made['closed_median'], '.0%')} | |")
    lines.append(f"| median value error | {_number(made['value_error_median'], '.1%')} | |")
    seconds = f"{_number(made['seconds_median'], '.0f')}, {_number(made['seconds_most'], '.0f')}"
    lines.append(f"| seconds a case, median and most | {seconds} | <= 180 |")
    lines += ["", "## By effect", "", "| hidden | right | found | gap closed | value error | values right | seconds | answers |"]
    lines.append("| --- " * 8 + "|")
    for name, one in made["effects"].items():
        answers = made["confusion"].get(name) or made["confusion"].get(_library(name), {})
        said = ", ".join(f"{answer} {count}" for answer, count in answers.items())
        cells = [name, _share(one["right"]), _share(one["found"]), _number(one["closed"], ".0%")]
        cells += [_number(one["value_error"], ".1%"), _share(one["values_right"]), _number(one["seconds"], ".0f"), said]
        lines.append(f"| {' | '.join(cells)} |")
    lines += ["", "A star marks the right name at the wrong place.", "", "## Verdicts", "", "| cases | verdicts |", "| --- | --- |"]
    lines += [f"| {sort} | {', '.join(f'{v} {n}' for v, n in some.items())} |" for sort, some in made["verdicts"].items()]
    lines += _pairs(rows) + _baselines(made["baselines"])
    return "\n".join(lines) + "\n"


def _pairs(rows: Sequence[Row]) -> list[str]:
    pairs = [r for r in rows if r["sort"] == "pair" or not r["right"]]
    lines = ["", "## Pairs, and every wrong answer", "", "| case | hidden | verdict | named | right |", "| --- " * 5 + "|"]
    for row in pairs:
        right = "yes" if row["right"] else "no"
        lines.append(f"| {row['case']} | {', '.join(row['hidden'])} | {row['verdict']} | {', '.join(row['named'])} | {right} |")
    return lines


def _baselines(made: Mapping[str, Any]) -> list[str]:
    if not made:
        return []
    lines = ["", "## Baselines on the same cases", "", "| method | one effect right | false alarms | median gap closed | seconds |"]
    lines.append("| --- " * 5 + "|")
    for method, one in made.items():
        cells = [method, _share(one["single_right"]), _share(one["false_alarm"]), _number(one["closed_median"], ".0%")]
        lines.append(f"| {' | '.join(cells)} | {_number(one['seconds_median'], '.0f')} |")
    return lines


def _library(hidden: str) -> str:
    return hidden if KINDS[hidden].foreign else library_name(hidden)


def _share(counts: Sequence[int] | None) -> str:
    if not counts or not counts[1]:
        return ""
    return f"{counts[0]} of {counts[1]} ({counts[0] / counts[1]:.0%})"


def _number(number: float | None, form: str) -> str:
    return "" if number is None else format(number, form)
