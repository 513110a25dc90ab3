"""The report of a policy: how often it succeeds, in the paper's form of table, and how it came to that."""

import base64
from collections.abc import Mapping, Sequence
from itertools import cycle
from textwrap import fill
from typing import Any

import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure as Canvas

from edream.practice.naming import brief
from edream.practice.ranking import taught_nothing
from edream.report.page import AFTER, BEFORE, COMMAND, PUBLISHED, Figure, draw, log_scale, page
from edream.report.recordings import about_recordings

LABEL = 26  # characters in a line beside a figure
LINES = ((AFTER, "o-"), (BEFORE, "s--"), (PUBLISHED, "^:"), (COMMAND, "d-."))


def policy_page(made: Mapping[str, Mapping[str, Any]], robot: str) -> str:
    """The page as HTML.

    Args:
        made: stage -> file name -> value, of ingest, sft, evaluate and every policy that was judged.
        robot: what to call it.
    """
    judged, sft = made["evaluate"], made["sft"]
    summary = judged["summary.json"]
    rows = summary["rates"]
    called = [brief(row["name"]) for row in rows]
    names = {row["policy"]: row["name"] if called.count(one) > 1 else one for row, one in zip(rows, called, strict=True)}
    tried = {policy: name for policy, name in names.items() if policy.split(" ")[0] == "rl"}
    histories = {name: made[policy]["history.json"] for policy, name in tried.items()}
    outcomes = {(row["policy"], row["start"]): row["success"] for row in judged["outcomes.parquet"].to_pylist()}
    content = {
        "title": f"{summary['task']} on {robot}",
        "sentence": summary["sentence"],
        "tiles": [(brief(row["name"]), f"{100 * row['success']['share']:.1f}", "% success") for row in rows]
        + [("starts", str(summary["starts"]), "each, the same for all")],
        "task": summary["task"],
        "rows": [_row(row) for row in rows],
        "rates": _rates(rows),
        "films": _films(judged, outcomes, rows),
        "curves": [
            _supervised(sft["losses.json"]),
            *([_rounds(histories)] if histories else []),
            *(
                _ratios(number, name, told)
                for number, (policy, name) in enumerate(tried.items())
                if (told := made[policy]["losses.json"])
            ),
        ],
        "history": [{"policy": name} | row for name, history in histories.items() for row in history],
        "stages": [("SFT", sft["summary.json"]["sentence"]), *((name, _made(made[policy])) for policy, name in tried.items())],
        "recordings": about_recordings(made["ingest"]),
    }
    return page("policy.html.j2", content)


def _made(one: Mapping[str, Any]) -> str:
    """How a policy learned from trials, all of their rounds together."""
    history = one["history.json"]
    if len(history) < 2:
        return str(one["summary.json"]["sentence"])
    first, last = (100 * row["success"] for row in (history[0]["before"], history[-1]["kept"]))
    said = f"{len(history)} rounds of trials: success on held-out starts in the simulator from {first:.0f} % to {last:.0f} %."
    return f"{said} {taught_nothing(history)}".rstrip()


def _row(row: Mapping[str, Any]) -> dict[str, str]:
    return {
        "name": row["name"],
        "success": _rate(row["success"]),
        "grasp": _rate(row["grasp"]) if row["grasp"] else "–",
        "distance": f"{100 * row['distance_m']:.1f}",
        "trials": f"{row['success']['successes']} of {row['success']['trials']}",
    }


def _rate(one: Mapping[str, Any]) -> str:
    low, high = one["interval"]
    return f"{100 * one['share']:.1f} [{100 * low:.1f}, {100 * high:.1f}]"


def _rates(rows: Sequence[Mapping[str, Any]]) -> Figure:
    def plot(canvas: Canvas) -> None:
        axis = canvas.subplots()
        for place, row in enumerate(reversed(rows)):
            for what, colour, shift in (("success", AFTER, 0.12), ("grasp", COMMAND, -0.12)):
                one = row[what]
                if one:
                    share = 100 * one["share"]
                    reach = [[share - 100 * one["interval"][0]], [100 * one["interval"][1] - share]]
                    label = what if place == 0 else None
                    axis.errorbar([share], [place + shift], xerr=np.abs(reach), fmt="o", color=colour, capsize=3, label=label)
        axis.set_yticks(range(len(rows)), [fill(brief(row["name"]), LABEL) for row in reversed(rows)])
        axis.set(xlabel="share of starts [%]", xlim=(0, 100), ylim=(-0.6, len(rows) - 0.4))
        canvas.legend(loc="outside upper left", ncols=2)

    caption = "Share of starts with Wilson's 95 % interval; intervals that do not overlap tell two policies apart."
    return draw("rates", "Success and grasp", caption, plot, (8.0, 1.4 + 0.7 * len(rows)), wide=True)


def _supervised(losses: Mapping[str, Any]) -> Figure:
    def plot(canvas: Canvas) -> None:
        axis = canvas.subplots()
        taught = np.asarray(losses["train"])
        width = max(1, len(taught) // 50)
        axis.plot(
            np.arange(width, len(taught) + 1), np.convolve(taught, np.ones(width) / width, "valid"), color=COMMAND, label="training"
        )
        held = losses["heldout"]
        for name, label, line in (("l1", "held out, L1", "o-"), ("hidden", "held out, joints hidden, L1", "o--")):
            if name in held[0]:
                axis.plot([one["step"] for one in held], [one[name] for one in held], line, color=AFTER, label=label)
        log_scale(axis)
        axis.set(xlabel="training step [1]", ylabel="loss [spreads of the actions]")
        canvas.legend(loc="outside upper left", ncols=2)

    return draw("supervised", "Supervised training", "The weights with the least held-out error are kept.", plot, (5.6, 3.2))


def _rounds(histories: Mapping[str, Sequence[Mapping[str, Any]]]) -> Figure:
    def plot(canvas: Canvas) -> None:
        axis = canvas.subplots()
        for (name, history), (colour, line) in zip(histories.items(), cycle(LINES)):
            places = [0, *(row["round"] for row in history)]
            shares = [history[0]["before"]["success"], *(row["kept"]["success"] for row in history)]
            axis.plot(places, [100 * share for share in shares], line, color=colour, label=name)
        longest = max(len(history) for history in histories.values())
        axis.set(xlabel="round [1]", ylabel="success [%]", ylim=(0, 100), xticks=range(longest + 1))
        if len(histories) > 1:
            canvas.legend(loc="outside upper left")

    caption = "Success on held-out starts in the simulator, nothing left to chance; they decide which weights are kept."
    return draw("rounds", "Learning from trials", caption, plot, (5.6, 3.0 + 0.2 * len(histories)))


def _ratios(number: int, name: str, told: Sequence[Mapping[str, float]]) -> Figure:
    def plot(canvas: Canvas) -> None:
        axis = canvas.subplots()
        width = max(1, len(told) // 30)
        for which, colour in (("chosen", AFTER), ("rejected", BEFORE)):
            smooth = np.convolve([row[which] for row in told], np.ones(width) / width, "valid")
            axis.plot(np.arange(len(smooth)) + width, smooth, color=colour, label=which)
        axis.set(xlabel="step of the last round [1]", ylabel="log-ratio per number [1]")
        canvas.legend(loc="outside upper left", ncols=2)

    caption = (
        "Log-likelihood of what was executed, less that under the reference. Both fall a little, since the reference played the "
        "trials or is near who did; the rejected should fall further. Under tpo a round stops where the chosen fall by rl.slack."
    )
    return draw(f"ratios-{number}", f"Chosen and rejected trials: {name}", caption, plot, (5.6, 3.2))


def _films(judged: Mapping[str, Any], outcomes: Mapping[tuple[str, int], bool], rows: Sequence[Mapping[str, Any]]) -> list[Figure]:
    found = []
    for file in sorted(name for name in judged if name.startswith("films/") and name.endswith(".png")):
        number, _, start = file.removeprefix("films/").removesuffix(".png").partition("-")
        row = rows[int(number)]
        title = f"{brief(row['name'])}: {'success' if outcomes[row['policy'], int(start)] else 'failure'}"
        source = base64.b64encode(judged[file]).decode()
        drawing = Markup('<img class="pixels" alt="{}" src="data:image/png;base64,{}">').format(title, source)
        found.append(Figure(f"film-{number}-{int(start)}", title, f"Start {int(start)}.", drawing))
    return found
