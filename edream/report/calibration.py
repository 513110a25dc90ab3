"""The report of a calibration: how far off the simulator was, how far it is now, and what each number is worth."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.colors import Normalize
from matplotlib.figure import Figure as Canvas

from edream.report.overview import MILLI, maps, overlays
from edream.report.page import AFTER, BEFORE, Figure, draw, mrad, page, short
from edream.report.recordings import about_recordings
from edream.report.traces import Trace, from_lists, worst_and_median

LARGEST_MAP = 48  # parameters whose correlations a reader can still follow


def calibration_page(
    fitted: Mapping[str, Any],
    ingested: Mapping[str, Any],
    surrogate: Mapping[str, Any] | None,
    robot: str,
    methods: Sequence[Mapping[str, Any]] = (),
) -> str:
    """The page as HTML.

    Args:
        fitted: file name -> value, as the stage `fit` makes it.
        ingested: the same of `ingest`, and `surrogate` of the surrogate, where one was used.
        robot: what to call it.
        methods: ways to fit side by side, as `edream.calibration.methods` makes them; empty where nothing was compared.
    """
    summary, details = fitted["summary.json"], fitted["details.json"]
    joints = ingested["summary.json"]["joints"]
    traces = from_lists(fitted["replay.parquet"], joints)
    side = "heldout" if "heldout" in summary["error"] else "train"
    judge = summary["error"][side]
    judging = details["heldout"] or details["train"]
    content = {
        "title": f"Calibration of {robot}",
        "sentence": summary["sentence"],
        "summary": summary,
        "details": details,
        "judge": judge,
        "side": "motions it never saw" if side == "heldout" else "the motions it was fitted to",
        "joints": joints,
        "tiles": _tiles(judge, len(judging)),
        "gap": _gap_figures(traces, joints, details, judge),
        "overlays": [
            figure
            for name, word in zip(worst_and_median(traces, judging), ("worst", "median"), strict=False)
            for figure in overlays(traces, name, word)
        ],
        "parameters": _parameters(summary["parameters"], details["correlation"]["names"]),
        "grips": summary.get("grips", {}),
        "correlation": correlation([tied(name) for name in details["correlation"]["names"]], details["correlation"]["values"]),
        "history": history(details["history"]),
        "surrogate": None if surrogate is None else surrogate["summary.json"],
        "difference": (details["model_difference"] or "").splitlines(),
        "methods": methods,
        "hook": fitted[summary["hook"]] if "hook" in summary else None,
        "recordings": about_recordings(ingested),
    }
    return page("calibration.html.j2", content)


def _tiles(judge: Mapping[str, Any], motions: int) -> list[tuple[str, str, str]]:
    before = judge["before"]
    return [
        ("joints, before", mrad(before["joint_rmse_rad"]), "mrad"),
        ("joints, after", mrad(judge["joint_rmse_rad"]), "mrad"),
        ("end effector, before", f"{before['translation_m'] * MILLI:.1f}", "mm"),
        ("end effector, after", f"{judge['translation_m'] * MILLI:.1f}", "mm"),
        ("judged on", str(motions), "motion" if motions == 1 else "motions"),
    ]


def _gap_figures(
    traces: Sequence[Trace], joints: Sequence[str], details: Mapping[str, Any], judge: Mapping[str, Any]
) -> list[Figure]:
    order = [*details["train"], *details["heldout"]]
    rms = {(t.motion, t.joint): (t.rms("before"), t.rms("after")) for t in traces}
    order = [name for name in order if (name, joints[0]) in rms]
    cells = np.array([[rms[name, joint] for joint in joints] for name in order]).reshape(len(order), len(joints), 2)
    cells = np.minimum(cells, 10.0)
    kept = len([name for name in order if name in set(details["heldout"])])
    return [by_joint(judge, joints), by_horizon(judge), maps(joints, order, cells[..., 0], cells[..., 1], kept)]


def by_joint(judge: Mapping[str, Any], joints: Sequence[str]) -> Figure:
    """Error of each joint before and after."""

    def plot(canvas: Canvas) -> None:
        axis = canvas.subplots()
        places = np.arange(len(joints))
        for offset, (label, values, colour) in enumerate(
            (
                ("before", judge["before"]["per_joint"], BEFORE),
                ("after", judge["per_joint"], AFTER),
            )
        ):
            axis.bar(
                places + (offset - 0.5) * 0.36, [values[name] * MILLI for name in joints], width=0.33, color=colour, label=label
            )
        axis.set_xticks(
            places,
            [short(name, 16) for name in joints],
            rotation=30 if len(joints) > 3 else 0,
            ha="right" if len(joints) > 3 else "center",
        )
        axis.set_ylabel("root-mean-square error [mrad]")
        axis.grid(False, axis="x")
        canvas.legend(loc="outside upper left", ncols=3, handlelength=1.2)

    caption = "Blue below orange is what the calibration gained on each joint."
    return draw("by-joint", "Error by joint", caption, plot, (5.6, 3.2))


def by_horizon(judge: Mapping[str, Any]) -> Figure:
    """Error by how long the simulation runs on its own."""
    names = sorted(judge["by_horizon"], key=lambda name: float("inf") if name == "whole" else float(name.split()[0]))

    def plot(canvas: Canvas) -> None:
        axis = canvas.subplots()
        for label, table, colour in (("before", judge["before"], BEFORE), ("after", judge, AFTER)):
            values = [table["by_horizon"][name]["joint_rmse_rad"] * MILLI for name in names]
            axis.plot(range(len(names)), values, "o-", color=colour, markersize=4, label=label)
        axis.set_xticks(range(len(names)), ["whole motion" if name == "whole" else name for name in names])
        axis.set_ylim(bottom=0.0)
        axis.set(xlabel="the simulation runs on its own for", ylabel="root-mean-square error [mrad]")
        canvas.legend(loc="outside upper left", ncols=2)

    caption = "Open-loop error after restarting at measured states; a line that stays flat means that errors do not build up."
    return draw("by-horizon", "Error by horizon", caption, plot, (5.6, 3.2))


def correlation(names: Sequence[str], values: Any) -> Figure | None:
    """How the estimates depend on each other."""
    if not 2 <= len(names) <= LARGEST_MAP:
        return None

    def plot(canvas: Canvas) -> None:
        axis = canvas.subplots()
        drawn = axis.pcolormesh(np.asarray(values), cmap="RdBu_r", norm=Normalize(-1.0, 1.0), edgecolors="white", linewidth=0.5)
        axis.set_aspect("equal")
        ticks = np.arange(len(names)) + 0.5
        axis.set_xticks(ticks, [short(name) for name in names], rotation=50, ha="right", fontsize=8)
        axis.set_yticks(ticks, [short(name) for name in names], fontsize=8)
        axis.invert_yaxis()
        axis.grid(False)
        axis.tick_params(length=0)
        canvas.colorbar(drawn, ax=axis, label="correlation [1]", shrink=0.8)

    caption = (
        "Dark red or blue away from the diagonal: the recordings tell the two numbers apart badly, so do not read them one by one."
    )
    return draw(
        "correlation",
        "Which numbers depend on each other",
        caption,
        plot,
        (9.2, 7.4) if len(names) > 8 else (5.6, 4.6),
        wide=len(names) > 8,
    )


def history(values: Sequence[float]) -> Figure | None:
    """The best loss as the search went on."""
    if len(values) < 3:
        return None

    def plot(canvas: Canvas) -> None:
        axis = canvas.subplots()
        axis.plot(range(len(values)), np.sqrt(np.asarray(values)) * MILLI, ".-", color=AFTER)
        axis.set(xlabel="step of the search [1]", ylabel="root of the loss [mrad]")

    return draw("history", "The search", "The best loss so far; a flat end means that the search had arrived.", plot, (5.6, 3.0))


def tied(name: str) -> str:
    """`coulomb.torque[a+b+c]`, a number that joints share, as `coulomb.torque (3 joints)`."""
    quantity, _, joints = name.removesuffix("]").partition("[")
    return f"{quantity} ({joints.count('+') + 1} joints)" if joints.count("+") > 1 else name


def _parameters(parameters: Mapping[str, Mapping[str, Any]], order: Sequence[str]) -> list[dict[str, Any]]:
    """Rows of the table in the order of the search."""
    words = {"converged": "found", "at_bound": "at its bound", "not_identifiable": "not identifiable"}
    names = [*order, *(name for name in parameters if name not in set(order))]
    return [
        {"name": tied(name), **parameters[name], "word": words[parameters[name]["status"]]} for name in names if name in parameters
    ]
