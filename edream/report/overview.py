"""Figures of any report: how large the gap is, where it lies, how motions look before and after."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.colors import Normalize
from matplotlib.figure import Figure as Canvas

from edream.report.page import AFTER, BEFORE, COMMAND, INK, MEASURED, PUBLISHED, Figure, draw, mrad, short
from edream.report.traces import Trace, busiest_joints, worst_stretch

MILLI = 1e3
STRETCH = 10.0  # s of a motion that a reader can follow
CLOSE = 0.8  # s in which lines can be told apart
LABELLED = 24  # more motions than this are numbered, not named
DRAWS = 4000
BEYOND = 8.0  # times the largest other error: a first one that would leave the others no room


def ladder(steps: Sequence[tuple[str, Sequence[float]]], floor: float | None, unstable: Sequence[str] = ()) -> Figure:
    """Error on motions that were never fitted, one bar a step.

    Args:
        steps: label, and the error [rad] of each motion.
        floor: noise of the measurement [rad].
        unstable: motions on which the first step's simulation blows up; where there are any, it gets no bar. One that is far
            larger than all others gets a bar that leaves the scale.
    """
    rms = [float(np.sqrt(np.mean(np.square(errors)))) for _, errors in steps]
    far = not unstable and len(steps) > 1 and rms[0] > BEYOND * max(rms[1:])
    spans = [interval(np.asarray(errors)) for _, errors in steps]
    first = int(bool(unstable) or far)  # of the steps that are drawn to scale
    edge = max(max(high, max(errors)) for (_, high), (_, errors) in list(zip(spans, steps, strict=True))[first:]) * MILLI
    colours = [PUBLISHED, BEFORE, *[AFTER] * len(steps)]

    def plot(canvas: Canvas) -> None:
        axis = canvas.subplots()
        places = np.arange(len(steps))[::-1]
        axis.barh(places[first:], np.array(rms[first:]) * MILLI, height=0.56, color=colours[first : len(steps)], alpha=0.85)
        for place, value, (low, high), (_, errors) in list(zip(places, rms, spans, steps, strict=True))[first:]:
            axis.plot([low * MILLI, high * MILLI], [place, place], color=INK, linewidth=1.6, solid_capstyle="butt")
            axis.plot(np.asarray(errors) * MILLI, np.full(len(errors), place - 0.37), "|", color=INK, markersize=5, alpha=0.6)
            axis.text(max(high, value) * MILLI + 0.015 * edge, place, f"{mrad(value)} mrad", va="center")
        if unstable:
            axis.text(0.015 * edge, places[0], "unstable with its own steps", va="center")
        elif far:
            axis.barh(places[0], 1.16 * edge, height=0.56, color=PUBLISHED, alpha=0.85)
            word = f"{mrad(rms[0])} mrad, beyond this scale \N{RIGHTWARDS ARROW} "
            axis.text(1.15 * edge, places[0], word, va="center", ha="right", color="white")
        if floor is not None:
            axis.axvline(floor * MILLI, color=COMMAND, linewidth=1.2, linestyle="--")
            axis.text(floor * MILLI, len(steps) - 0.45, f" noise {mrad(floor)} mrad", va="bottom", fontsize=8.5)
        axis.set_yticks(places, [short(label, 34) for label, _ in steps])
        axis.set_ylim(-0.7, len(steps) - 0.1)
        axis.set_xlim(0.0, 1.16 * edge)
        axis.set_xlabel("root-mean-square error on motions never fitted [mrad]")
        axis.grid(False, axis="y")

    count = len(steps[0][1])
    caption = (
        f"Each bar is the error on the {count} motions that were never fitted, the line on it its 95 % interval over motions, "
        "ticks are single motions. Shorter is better, and nothing can be shorter than the noise."
    )
    return draw("ladder", "How far off", caption, plot, (9.2, 1.3 + 0.52 * len(steps)), wide=True)


def interval(errors: Float[np.ndarray, "M"]) -> tuple[float, float]:
    """95 % bootstrap interval of the root mean square over motions [rad]."""
    rng = np.random.default_rng(13)
    drawn = np.square(errors)[rng.integers(0, len(errors), (DRAWS, len(errors)))]
    low, high = np.percentile(np.sqrt(drawn.mean(axis=1)), [2.5, 97.5])
    return float(low), float(high)


def maps(joints: Sequence[str], motions: Sequence[str], before: Any, after: Any, kept: int) -> Figure:
    """Error of each joint in each motion, before and after, in one colour scale.

    Args:
        before, after: errors [rad], one row a motion.
        kept: how many of the last motions were never fitted.
    """
    values = [np.asarray(one, dtype=float).reshape(len(motions), len(joints)).T * MILLI for one in (before, after)]
    top = float(np.nanpercentile(values[0], 99)) or 1.0

    def plot(canvas: Canvas) -> None:
        axes = canvas.subplots(2, 1, sharex=True)
        for axis, title, cells in zip(axes, ("before", "after"), values, strict=True):
            drawn = axis.pcolormesh(cells, cmap="YlOrRd", norm=Normalize(0.0, top), edgecolors="white", linewidth=0.6)
            axis.set_title(title)
            axis.set_yticks(np.arange(len(joints)) + 0.5, [short(name, 18) for name in joints])
            axis.invert_yaxis()
            axis.grid(False)
            axis.tick_params(length=0)
            for colour, width in (("#ffffff", 4.5), ("#222222", 1.8)):
                axis.axvline(len(motions) - kept, color=colour, linewidth=width)
            if len(motions) <= LABELLED:
                for (row, column), value in np.ndenumerate(cells):
                    colour = "#ffffff" if value > 0.62 * top else "#222222"
                    axis.text(column + 0.5, row + 0.5, mrad(value / MILLI), ha="center", va="center", fontsize=7.5, color=colour)
        _motion_ticks(axes[1], motions)
        canvas.colorbar(drawn, ax=list(axes), label="error [mrad]", pad=0.015, aspect=30)

    caption = (
        "Root-mean-square error of every joint in every motion, in one colour scale; right of the upright line are the motions "
        "that were never fitted. Where the lower map is paler, the gap has closed; what stays dark is unexplained."
    )
    return draw("maps", "Where the error lies", caption, plot, (9.2, 1.9 + 0.62 * len(joints)), wide=True)


def _motion_ticks(axis: Any, motions: Sequence[str]) -> None:
    if len(motions) <= LABELLED:
        axis.set_xticks(np.arange(len(motions)) + 0.5, [short(name, 20) for name in motions], rotation=40, ha="right", fontsize=8)
    else:
        axis.set_xlabel("motion, by number")


def overlays(traces: Sequence[Trace], motion: str, word: str, most: int = 2) -> list[Figure]:
    """Measured, before and after of one motion, for the joints with the largest errors.

    Args:
        word: what the motion stands for, such as "worst".
    """
    own = [trace for trace in traces if trace.motion == motion]
    chosen = busiest_joints(own, most)
    return [_overlay(next(t for t in own if t.joint == joint), word) for joint in chosen]


def _overlay(trace: Trace, word: str) -> Figure:
    first, last = worst_stretch(trace, STRETCH)
    seen = trace.part(first, last)
    near = seen.part(*worst_stretch(seen, CLOSE, visible=True))

    def plot(canvas: Canvas) -> None:
        upper, lower, zoom = canvas.subplots(3, 1, height_ratios=(1.2, 1, 1.4))
        lower.sharex(upper)
        upper.tick_params(labelbottom=False)
        for axis, part in ((upper, seen), (zoom, near)):
            positions(axis, part)
            axis.set_ylabel("position [rad]")
        handles = upper.get_legend_handles_labels()
        canvas.legend(*handles, loc="outside upper left", ncols=4, handlelength=1.6, columnspacing=1.2)
        lower.axhline(0.0, color=COMMAND, linewidth=0.8)
        lower.plot(seen.time, seen.error("before") * MILLI, color=BEFORE, linewidth=1.1)
        lower.plot(seen.time, seen.error("after") * MILLI, color=AFTER, linewidth=1.1)
        lower.set_ylabel("error [mrad]")
        for axis in (upper, lower):
            axis.axvspan(near.time[0], near.time[-1], color=COMMAND, alpha=0.18, linewidth=0)
        zoom.set_xlabel("time [s]; the shaded stretch, close up")

    shown = "" if (first, last) == (trace.time[0], trace.time[-1]) else f" Shown are the {STRETCH:.0f} s with the largest error."
    caption = (
        f"The error over the whole motion is {mrad(trace.rms('before'))} mrad before and {mrad(trace.rms('after'))} mrad after; "
        f"the closer the blue line lies to the measured one, the better.{shown}"
    )
    title = f"{trace.joint} in {short(trace.motion, 36)} ({word} motion)"
    return draw(f"overlay-{word}-{trace.joint}", title, caption, plot, (5.6, 4.9))


def positions(axis: Any, seen: Trace) -> None:
    """Command, measured, before and after in their colours."""
    if seen.follows:
        axis.plot(seen.time, seen.command, color=COMMAND, linewidth=1.0, label="command")
    axis.plot(seen.time, seen.measured, color=MEASURED, linewidth=2.0, label="measured")
    axis.plot(seen.time, seen.before, color=BEFORE, label="before")
    axis.plot(seen.time, seen.after, color=AFTER, linestyle=(0, (4, 1.5)), label="after")
