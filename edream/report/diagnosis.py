"""The report of a diagnosis: from the sentence down to the evidence."""

import csv
import io
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure as Canvas

from edream.diagnosis.set_up import how_to_record
from edream.report.overview import ladder, maps, overlays
from edream.report.page import AFTER, Figure, draw, mrad, page, short
from edream.report.recordings import about_recordings
from edream.report.signature import dependence, signature
from edream.report.traces import Trace, from_rows, worst_and_median

SMALLEST = 0.005  # share below which a candidate is not worth a word
VERDICTS = {
    "named": "something is missing, and it has a name",
    "none": "nothing that is missing shows",
    "cannot_tell": "something is missing, and these motions leave its name open",
    "unnamed": "something is missing that has no name yet",
}


def diagnosis_page(found: Mapping[str, Any], ingested: Mapping[str, Any], robot: str) -> str:
    """The page as HTML.

    Args:
        found: file name -> value, as the stage `diagnose` makes it.
        ingested: the same of `ingest`.
        robot: what to call it.
    """
    result = found["summary.json"]
    traces = from_rows(found["traces.parquet"])
    motions = result["motions"]
    content = {
        "title": f"Diagnosis of {robot}",
        "sentence": result["sentence"],
        "result": result,
        "beyond": any((effect["closed"] or 0.0) > 1.0 for effect in result["effects"]),
        "verdict": VERDICTS[result["verdict"]],
        "tiles": _tiles(result, len(motions["proof"])),
        "gap": _gap_figures(found),
        "visible": _visible(result, traces),
        "overlays": [
            figure
            for name, word in zip(worst_and_median(traces, motions["proof"]), ("worst", "median"), strict=False)
            for figure in overlays(traces, name, word)
        ],
        "ranking": _ranking(found["ranking.json"]),
        "nuisance": [{"unit": "", **row} for row in found["nuisance.json"]],
        "grips": result.get("grips", {}),
        "difference": found["difference.txt"].splitlines() if "difference.txt" in found else [],
        "hook": found["hook.py"] if "hook.py" in found else None,  # noqa: SIM401 - an artifact's own error is not KeyError
        "next_motion": next_motion(found["next_motion.csv"], found["next_motion.json"]) if "next_motion.csv" in found else None,
        "recordings": about_recordings(ingested),
    }
    return page("diagnosis.html.j2", content)


def _tiles(result: Mapping[str, Any], kept: int) -> list[tuple[str, str, str]]:
    """The numbers that a reader takes away: label, value, unit."""
    gap, unstable = result["gap"], result.get("unstable")
    return [
        ("published model", "unstable", "") if unstable else ("published model", mrad(gap["published_rad"]), "mrad"),
        ("calibrated, nothing added", mrad(gap["before_rad"]), "mrad"),
        ("with what was missing", mrad(gap["after_rad"]), "mrad"),
        ("noise of the recordings", mrad(gap["noise_floor_rad"]), "mrad"),
        ("never fitted", str(kept), "motion" if kept == 1 else "motions"),
    ]


def _gap_figures(found: Mapping[str, Any]) -> list[Figure]:
    steps = [(_step(one["step"]), one["motions_rad"]) for one in found["ladder.json"]]
    errors = found["errors.json"]
    if len(steps) > 2:  # what stayed was refitted once more; earlier steps may have gone out again
        final = np.sqrt(np.mean(np.square(errors["after"][len(errors["motions"]) - errors["proof"] :]), axis=1)).tolist()
        steps = [*steps[:2], (steps[2][0], final)] if len(steps) == 3 else [*steps, ("what stayed, refitted", final)]
    return [
        ladder(steps, found["summary.json"]["gap"]["noise_floor_rad"], found["summary.json"].get("unstable", ())),
        maps(errors["joints"], errors["motions"], errors["before"], errors["after"], errors["proof"]),
    ]


def _step(label: str) -> str:
    return {"published": "published model", "calibrated": "calibrated, nothing added", "remainder": "+ formula for the rest"}.get(
        label, label
    )


def _visible(result: Mapping[str, Any], traces: Sequence[Trace]) -> list[tuple[str, list[Figure]]]:
    """For each named effect the figures that show it; where none is named, what is left along everything."""
    groups = []
    for effect in result["effects"]:
        place = ", ".join(effect["targets"])
        groups.append(
            (f"{effect['name']} on {place}" if place else effect["name"], signature(effect["name"], effect["targets"], traces))
        )
    if result["verdict"] in ("none", "unnamed") or not groups:
        groups.append(("what is left, along everything it may depend on", dependence(traces)))
    return groups


def _ranking(rounds: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Each round's candidates, refitted ones first, with what the screening gave them."""
    out = []
    for one in rounds:
        share = {s["candidate"]: s["share"] for s in one["screened"]}
        rows = [{**trial, "share": share.get(trial["candidate"])} for trial in one["refitted"]]
        tried = {row["candidate"] for row in rows}
        rest = [s for s in one["screened"] if s["candidate"] not in tried and s["share"] >= SMALLEST]
        out.append({**one, "rows": rows, "rest": rest[:8], "more": len(one["screened"]) - len(rows) - len(rest[:8])})
    return out


def next_motion(text: str, conditions: Sequence[Mapping[str, float]]) -> Figure | None:
    """The motion to record next, as commands over time, and under what conditions; None where the file has no row."""
    rows = list(csv.reader(io.StringIO(text)))
    if len(rows) < 2 or len(rows[0]) < 2:
        return None
    values = np.array([[float(cell) for cell in row] for row in rows[1:]])

    def plot(canvas: Canvas) -> None:
        axes = np.atleast_1d(canvas.subplots(len(rows[0]) - 1, 1, sharex=True))
        for axis, name, column in zip(axes, rows[0][1:], values.T[1:], strict=True):
            axis.plot(values[:, 0], column, color=AFTER)
            axis.set_ylabel(f"{short(name, 16)}\n[rad]", fontsize=8)
        axes[-1].set_xlabel("time [s]")

    caption = (
        "The commands of a motion that tells the candidates apart; next_motion.csv among the diagnosis' files holds it. "
        + how_to_record(conditions)
    )
    return draw("next-motion", "What to record next", caption, plot, (9.2, 1.0 + 0.95 * (len(rows[0]) - 1)), wide=True)
