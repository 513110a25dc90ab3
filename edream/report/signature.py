"""The picture in which a person sees an effect: each kind of effect shows itself along something else."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure as Canvas

from edream.report.overview import MILLI, positions
from edream.report.page import AFTER, BEFORE, COMMAND, MEASURED, Figure, draw, short
from edream.report.traces import Trace

POINTS = 5000  # in one cloud
BINS = 16
LOADED = 0.1  # of the widest range of load among the joints
MOVING = 0.01  # rad/s; slower than that has no direction
UP, DOWN = "#1f9e74", "#b4489a"
AFTER_JUMP = np.arange(-0.04, 0.3001, 0.004)  # s

ALONG: dict[str, tuple[str, Callable[[Trace], np.ndarray]]] = {
    "speed": ("measured speed [rad/s]", lambda trace: trace.speed),
    "position": ("measured position [rad]", lambda trace: trace.measured),
    "load": ("torque of gravity [N m]", lambda trace: trace.load if trace.load is not None else trace.measured),
    "time": ("time since the motion began [s]", lambda trace: trace.time),
}
SHOWS = {
    "coulomb": "speed", "stribeck": "speed", "viscous": "speed", "quadratic_drag": "speed", "presliding": "speed",
    "derivative_gain": "speed", "torque_speed_limit": "saturation", "slew_limit": "saturation", "torque_limit": "saturation",
    "load_friction": "load", "directional_efficiency": "load", "servo_gain": "load", "compliance": "load", "dead_zone": "load",
    "integral_action": "load", "asymmetric_coulomb": "position", "position_friction": "position", "backlash": "position",
    "spring": "position", "hardening_spring": "position", "gravity_tilt": "position", "constant_torque": "position",
    "encoder_offset": "position", "sensor_bias": "position", "payload": "position", "gear_ratio": "position",
    "joint_coupling": "position",
    "actuator_delay": "lag", "sensor_delay": "lag", "actuator_lag": "lag", "armature": "lag", "cogging": "spectrum",
    "gain_fade": "drift", "friction_fade": "drift",
}  # fmt: skip


def signature(effect: str, targets: Sequence[str], traces: Sequence[Trace]) -> list[Figure]:
    """Figures that make an effect visible on the joint where it costs most.

    Args:
        effect: its name in the library; one that is not known is drawn against speed and position.
        targets: where it acts; those that are no joints leave the joint with the largest error.
        traces: motions that were never fitted.
    """
    kind = SHOWS.get(effect, "dependence")
    chosen = [trace for trace in traces if trace.joint in _joints(targets)] or list(traces)
    own = _worst_joint(_loaded(chosen) if kind == "load" else chosen)
    if not own:
        return []
    if kind != "spectrum" and not own[0].follows:  # nothing follows a torque
        ways = [kind, "speed", "position"] if kind == "load" else ["speed", "position"]
        return [_left(effect, own, along) for along in ways]
    if kind in ALONG:
        return [
            _loops(effect, own, kind),
            _left(effect, own, kind),
            _left(effect, own, "speed" if kind == "position" else "position"),
        ]
    drawn = {"lag": _lag, "spectrum": _spectrum, "drift": _drift, "saturation": _saturation, "dependence": _dependence}[kind]
    return drawn(effect, own)


def dependence(traces: Sequence[Trace]) -> list[Figure]:
    """What is left on the worst joint, along everything that it may depend on."""
    own = _worst_joint(traces)
    return [_left("left", own, along) for along in ALONG if along != "load" or own[0].load is not None] if own else []


def _dependence(effect: str, own: Sequence[Trace]) -> list[Figure]:
    return [_left(effect, own, along) for along in ("speed", "position")]


def _joints(targets: Sequence[str]) -> set[str]:
    return {part for target in targets for part in target.split("<-")}


def _worst_joint(traces: Sequence[Trace]) -> list[Trace]:
    """The traces of the joint with the largest error before."""
    size: dict[str, float] = {}
    for trace in traces:
        size[trace.joint] = size.get(trace.joint, 0.0) + min(trace.rms("before"), 1e3) ** 2
    return [trace for trace in traces if trace.joint == max(size, key=lambda joint: size[joint])] if size else []


def _loaded(traces: Sequence[Trace]) -> list[Trace]:
    """Those of joints that gravity loads now more and now less; all, where no joint is."""
    span = {trace.joint: 0.0 for trace in traces}
    for trace in traces:
        if trace.load is not None:
            span[trace.joint] = max(span[trace.joint], float(np.ptp(trace.load)))
    return [trace for trace in traces if span[trace.joint] >= LOADED * max(span.values())]


@dataclass(frozen=True, eq=False)
class _Cloud:
    """Points and the direction of motion at each: +1, -1, or 0 at rest."""

    x: Float[np.ndarray, "N"]
    y: Float[np.ndarray, "N"]
    direction: Float[np.ndarray, "N"]


def _cloud(own: Sequence[Trace], x: Callable[[Trace], np.ndarray], y: Callable[[Trace], np.ndarray]) -> _Cloud:
    xs, ys = (np.concatenate([np.asarray(value(trace)) for trace in own]) for value in (x, y))
    speed = np.concatenate([trace.speed for trace in own])
    direction = np.where(np.abs(speed) < MOVING, 0.0, np.sign(speed))
    good = np.isfinite(xs) & np.isfinite(ys)
    return _Cloud(xs[good], ys[good], direction[good])


def _scatter(axis: Any, cloud: _Cloud) -> None:
    step = max(1, len(cloud.x) // POINTS)
    for sign, colour in ((1.0, UP), (-1.0, DOWN)):
        rows = np.flatnonzero(cloud.direction == sign)
        axis.plot(cloud.x[rows[::step]], cloud.y[rows[::step]], ".", color=colour, markersize=2.0, alpha=0.28, rasterized=True)
        for line, centre in [_medians(cloud.x[rows], cloud.y[rows])]:
            axis.plot(line, centre, color=colour, linewidth=2.2)


def _medians(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Median of y in equally filled bins of x; empty where there are too few points."""
    if len(x) < 8 * BINS:
        return np.zeros(0), np.zeros(0)
    parts = np.array_split(np.argsort(x, kind="stable"), BINS)
    return np.array([np.median(x[p]) for p in parts]), np.array([np.median(y[p]) for p in parts])


def _limits(clouds: Sequence[_Cloud]) -> tuple[float, float]:
    values = np.concatenate([cloud.y for cloud in clouds])
    low, high = np.percentile(values, [1.5, 98.5])
    room = 0.15 * max(high - low, 1e-9)
    return float(low - room), float(high + room)


def _panels(clouds: Sequence[_Cloud], titles: Sequence[str], x: str, y: str) -> Callable[[Canvas], None]:
    """Clouds side by side in one scale, coloured by direction."""

    def plot(canvas: Canvas) -> None:
        axes = np.atleast_1d(canvas.subplots(1, len(clouds), sharex=True, sharey=True))
        for axis, cloud, title in zip(axes, clouds, titles, strict=True):
            _scatter(axis, cloud)
            axis.axhline(0.0, color=COMMAND, linewidth=0.8)
            axis.set_title(title)
            axis.set_xlabel(x)
            axis.locator_params(axis="x", nbins=4)
        axes[0].set_ylim(*_limits(clouds))
        axes[0].set_ylabel(y)
        for colour, label in ((UP, "moving up"), (DOWN, "moving down")):
            axes[0].plot([], [], color=colour, linewidth=2.2, label=label)
        canvas.legend(loc="outside upper right", ncols=2, handlelength=1.4)

    return plot


def _loops(effect: str, own: Sequence[Trace], along: str) -> Figure:
    label, x = ALONG[along]
    sides = ("measured", "before", "after")
    plain = _linear_part(own, along)
    clouds = [
        _cloud(own, x, lambda trace, side=side: (trace.command - getattr(trace, side) - plain(trace)) * MILLI) for side in sides
    ]
    less = {"speed": "speed, load and acceleration", "position": "load and acceleration"}.get(along)
    caption = (
        f"How far the joint stays behind its command{f', less what is proportional to {less}' if less else ''}, in every "
        "never-fitted motion: the third panel should look like the first; what the second panel lacks is the effect."
    )
    plot = _panels(clouds, ("measured", "simulated before", "simulated after"), label, "command less position [mrad]")
    return draw(
        f"loop-{effect}-{own[0].joint}",
        f"{own[0].joint}: following error along {_word(along)}",
        caption,
        plot,
        (9.2, 3.3),
        wide=True,
    )


def _linear_part(own: Sequence[Trace], along: str) -> Callable[[Trace], np.ndarray]:
    """The share of the measured following error that would hide a pattern along speed or position: [rad] as a function of a trace.

    Regressed together with the direction of motion, which stays in, so that dry friction is not taken for speed.
    """
    taken = {"speed": ("speed", "load", "acceleration"), "position": ("load", "acceleration")}.get(along, ())
    if not taken:
        return lambda trace: np.zeros(len(trace.time))

    def columns(trace: Trace) -> np.ndarray:
        known = {
            "speed": trace.speed,
            "load": trace.load if trace.load is not None else np.zeros(len(trace.time)),
            "acceleration": np.gradient(trace.speed, trace.time),
        }
        return np.stack([known[name] for name in taken], axis=1)

    rows = np.concatenate([np.column_stack([columns(t), np.tanh(t.speed / MOVING), np.ones(len(t.time))]) for t in own])
    target = np.concatenate([trace.command - trace.measured for trace in own])
    solved = np.linalg.lstsq(rows, target, rcond=None)[0]
    return lambda trace: columns(trace) @ solved[: len(taken)] + solved[-1]


def _left(effect: str, own: Sequence[Trace], along: str) -> Figure:
    label, x = ALONG[along]
    clouds = [_cloud(own, x, lambda trace, side=side: -trace.error(side) * MILLI) for side in ("before", "after")]
    caption = (
        f"What the simulation leaves unexplained along {_word(along)}: structure on the left that is flat on the right has been "
        "explained."
    )
    plot = _panels(clouds, ("before", "after"), label, "measured less simulated [mrad]")
    return draw(
        f"left-{effect}-{own[0].joint}-{along}", f"{own[0].joint}: what is left along {_word(along)}", caption, plot, (5.6, 3.2)
    )


def _word(along: str) -> str:
    return {"load": "the load of gravity", "time": "time"}.get(along, f"its {along}")


def _lag(effect: str, own: Sequence[Trace]) -> list[Figure]:
    """The fastest move, close up, and the typical response to a command that jumps."""
    fast = max(own, key=lambda trace: np.abs(np.gradient(trace.command, trace.time)).max())
    at = float(fast.time[np.argmax(np.abs(np.gradient(fast.command, fast.time)))])
    seen = fast.part(at - 0.1, at + 0.4)

    def zoom(canvas: Canvas) -> None:
        axis = canvas.subplots()
        positions(axis, seen)
        axis.set(xlabel="time [s]", ylabel="position [rad]")
        canvas.legend(loc="outside upper left", ncols=4, handlelength=1.6, columnspacing=1.2)

    joint = own[0].joint
    caption = f"The blue line should run with the measured one; the orange one starts or rises otherwise ({short(fast.motion)})."
    figures = [draw(f"zoom-{effect}-{joint}", f"{joint}: the fastest move, close up", caption, zoom)]
    sides = {"measured": MEASURED, "before": BEFORE, "after": AFTER}
    curves = {side: _responses(own, side) for side in sides}
    count = len(curves["measured"])
    if not count:
        return figures

    def response(canvas: Canvas) -> None:
        axis = canvas.subplots()
        for side, colour in sides.items():
            style = (0, (4, 1.5)) if side == "after" else "-"
            axis.plot(AFTER_JUMP * MILLI, np.median(curves[side], axis=0), color=colour, linestyle=style, label=side)
        axis.set(xlabel="time since the command jumped [ms]", ylabel="share of the jump [1]")
        canvas.legend(loc="outside upper left", ncols=3)

    jumps = "one jump" if count == 1 else f"{count} jumps"
    caption = (
        f"Median of {jumps} in never-fitted motions: a delay keeps the line at zero for longer, a lag or inertia makes it rise "
        "more slowly."
    )
    return [*figures, draw(f"response-{effect}-{joint}", f"{joint}: after the command jumps", caption, response)]


def _responses(own: Sequence[Trace], side: str) -> list[Float[np.ndarray, "S"]]:
    """Motion after each jump of the command, as a share of the jump."""
    out = []
    for trace in own:
        jumps = trace.command[2:] - trace.command[:-2]
        for row in np.flatnonzero(np.abs(jumps) > 0.7 * max(0.03, float(np.abs(jumps).max()))):
            start, grid = trace.time[row + 1], trace.time[row + 1] + AFTER_JUMP
            rests = np.ptp(trace.command[max(0, row - 12) : row + 1]) < 0.1 * abs(jumps[row])
            if rests and grid[0] >= trace.time[0] and grid[-1] <= trace.time[-1] and trace.command[row + 1] != trace.command[row]:
                position = np.interp(grid, trace.time, np.nan_to_num(getattr(trace, side)))
                out.append((position - np.interp(start, grid, position)) / jumps[row])
    return out


def _spectrum(effect: str, own: Sequence[Trace]) -> list[Figure]:
    """Amplitude of the error that repeats with the angle."""
    cycles = np.arange(2, 121)

    def amplitude(side: str) -> np.ndarray:
        angle = np.concatenate([trace.measured for trace in own])
        error = np.concatenate([np.nan_to_num(trace.error(side)) for trace in own])
        weight = np.concatenate([np.abs(np.gradient(trace.measured)) for trace in own])
        error = error - np.average(error, weights=weight)
        waves = np.exp(-1j * cycles[:, None] * angle[None, :])
        return 2 * np.abs(waves @ (weight * error)) / weight.sum() * MILLI

    def plot(canvas: Canvas) -> None:
        axis = canvas.subplots()
        for side, colour in (("before", BEFORE), ("after", AFTER)):
            axis.plot(cycles, amplitude(side), color=colour, label=side)
        axis.set(xlabel="ripples in one turn [1]", ylabel="amplitude of the error [mrad]")
        canvas.legend(loc="outside upper left", ncols=2)

    joint = own[0].joint
    caption = "A ripple that repeats with the angle is a peak at its number of repeats in a turn; after, no peak should stand out."
    return [draw(f"spectrum-{effect}-{joint}", f"{joint}: error by ripples in a turn", caption, plot, (9.2, 2.9), wide=True)]


def _drift(effect: str, own: Sequence[Trace]) -> list[Figure]:
    """How errors grow as a motion goes on."""
    last = max(float(trace.time[-1]) for trace in own)
    edges = np.linspace(0.0, last, 17)

    def curve(value: Callable[[Trace], np.ndarray]) -> np.ndarray:
        time = np.concatenate([trace.time for trace in own])
        squared = np.concatenate([np.nan_to_num(value(trace)) ** 2 for trace in own])
        which = np.clip(np.digitize(time, edges) - 1, 0, len(edges) - 2)
        count = np.maximum(np.bincount(which, minlength=len(edges) - 1), 1)
        return np.sqrt(np.bincount(which, squared, len(edges) - 1) / count) * MILLI

    def plot(sides: Sequence[tuple[str, str]], y: str, value: Callable[[Trace, str], np.ndarray]) -> Callable[[Canvas], None]:
        def panel(canvas: Canvas) -> None:
            axis = canvas.subplots()
            for side, colour in sides:
                axis.plot(
                    (edges[1:] + edges[:-1]) / 2, curve(lambda trace, side=side: value(trace, side)), color=colour, label=side
                )
            axis.set(xlabel=ALONG["time"][0], ylabel=y)
            axis.set_ylim(bottom=0.0)
            canvas.legend(loc="outside upper left", ncols=3)

        return panel

    joint, both = own[0].joint, [("before", BEFORE), ("after", AFTER)]
    follow = plot(
        [("measured", MEASURED), *both], "following error [mrad]", lambda trace, side: trace.command - getattr(trace, side)
    )
    error = plot(both, "error [mrad]", lambda trace, side: trace.error(side))
    changes = "The measured robot changes while it runs; the blue line should change with it, as the orange one does not."
    grows = "An error that grows with time is a drift that the simulator lacks; after, the line should be flat."
    return [
        draw(f"follow-{effect}-{joint}", f"{joint}: following error as time goes on", changes, follow),
        draw(f"drift-{effect}-{joint}", f"{joint}: simulation error as time goes on", grows, error),
    ]


def _saturation(effect: str, own: Sequence[Trace]) -> list[Figure]:
    """Speed against what the servo is asked for: a limit is a flat top."""
    sides = ("measured", "before", "after")
    clouds = [
        _cloud(
            own,
            lambda t, side=side: (t.command - getattr(t, side)) * MILLI,
            lambda t, side=side: np.gradient(getattr(t, side), t.time),
        )
        for side in sides
    ]
    caption = (
        "A limit is a flat top that more following error does not lift; the third panel should level off where the first does."
    )
    plot = _panels(clouds, ("measured", "simulated before", "simulated after"), "command less position [mrad]", "speed [rad/s]")
    joint = own[0].joint
    return [
        draw(f"flat-{effect}-{joint}", f"{joint}: speed by following error", caption, plot, (9.2, 3.3), wide=True),
        *_lag(effect, own),
    ]
