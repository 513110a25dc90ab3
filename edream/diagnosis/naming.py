"""What is named, and which of a robot's usual numbers are so far from the published ones that they are named."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from jaxtyping import Float

from edream.catalog import load
from edream.core.effect import Effect
from edream.core.parameters import Parameter
from edream.diagnosis.descent import SURE, Fit
from edream.diagnosis.problem import Problem
from edream.diagnosis.steps import in_continuous_time
from edream.diagnosis.suspects import ORDINARY, ordinary_own_damping
from edream.sim.scales import position_gain
from edream.sim.simulation import Placement, unit_at

NUDGE = 1e-4  # of the unit box, by which a slope is taken
ALIKE = 0.5  # of what a joint has, beside its servo's gain: so much makes another one like it
FEW = 2  # others, of which most can be like it


@dataclass(frozen=True)
class Named:
    """One effect that the simulator lacks.

    Attributes:
        name, summary: its entry in the library and the words of the sentence.
        targets: joints (or bodies) it acts on.
        values, intervals: its parameters by quantity, with 95 % intervals.
        units: their units.
        closed: share of the gap then remaining that it closed on left-out motions.
        runner_up: the next best candidate, and the share that it closed.
        confusable_with: candidates that these motions cannot tell from it.
        motion: the one fitted motion that shows it, which no share of motions left out can be said of; None where others do, too.
    """

    name: str
    summary: str
    targets: tuple[str, ...]
    values: Mapping[str, float]
    intervals: Mapping[str, tuple[float, float]]
    units: Mapping[str, str]
    closed: float
    runner_up: tuple[str, float] | None
    confusable_with: tuple[str, ...]
    motion: str | None = None


def numbers_of(
    problem: Problem, fit: Fit, place: Placement
) -> tuple[dict[str, float], dict[str, tuple[float, float]], dict[str, str]]:
    """An effect's fitted quantities at its place, their intervals and units, under their short names."""
    values, intervals = fit.space.mapping(fit.values), fit.intervals()
    parameters = place.effect.parameters(problem.robot.model, place.targets)
    full = {p.name: place.full_name(p.name) for p in parameters}
    return (
        {short: values[name] for short, name in full.items()},
        {short: intervals[name] for short, name in full.items()},
        {p.name: unit_at(p, problem.robot.model, place.targets) for p in parameters},
    )


def as_written(one: Named, found: Fit, written: Fit) -> Named:
    """What is named with the numbers that are written, which suit a plain loop, for those that were found; intervals go with them.

    A number that one of the two does not have stays.
    """
    before, after = (fit.space.mapping(fit.values) for fit in (found, written))
    place = f"[{'+'.join(one.targets)}]" if one.targets else ""
    full = {short: f"{one.name}.{short}{place}" for short in one.values}
    by = {short: after[name] - before[name] if name in before and name in after else 0.0 for short, name in full.items()}
    values = {short: value + by[short] for short, value in one.values.items()}
    return replace(one, values=values, intervals={n: (low + by[n], high + by[n]) for n, (low, high) in one.intervals.items()})


def strange_numbers(problem: Problem, fit: Fit) -> list[Named]:
    """Nuisance numbers that are far from the published ones, in the simulator's steps and in continuous time.

    What is published as zero on all joints and found on most of them is no news on one. A servo's damping goes with its gain: it is
    strange where neither what it is nor what it would be at the published gain may be expected. Where the motions tell a joint's
    own damping from its servo's, that is looked at by itself.
    """
    found = []
    fitted = fit.space.mapping(fit.values)
    steady = in_continuous_time(problem, fitted)
    gains: dict[tuple[str, ...], tuple[str, float]] = {}  # its full name, and times the published one
    for place in fit.objective.simulated.placements:
        if place.effect.name not in problem.settings.nuisance:
            continue
        values, intervals, units = numbers_of(problem, fit, place)
        for parameter in load("effects", place.effect.name, Effect).parameters(problem.robot.model, place.targets):
            full, (low, high) = place.full_name(parameter.name), intervals[parameter.name]
            if place.effect.name == "servo_gain" and parameter.start > 0.0:
                gains[place.targets] = full, values[parameter.name] / parameter.start
            shift = steady[full] - fitted[full]
            far = is_strange(parameter, (low + min(0.0, shift), high + max(0.0, shift)))
            gain, usual = gains.get(place.targets, ("", 1.0))
            if far and gain and place.effect.name == "viscous":
                far = is_strange(parameter, share_of(fit, full, gain, usual))
            if far and parameter.start == 0.0 and place.effect.place == "joint":
                far = not others_have_it(problem, fit, place, parameter.name)
            if {"damping", "inside"} <= values.keys():
                far = far or is_own_damping_strange(problem.robot.model, place.targets[0], own_damping(fit, place))
            if far:
                found.append(
                    Named(place.effect.name, place.effect.summary, place.targets, values, intervals, units, float("nan"), None, ())
                )
    return found


def others_have_it(problem: Problem, fit: Fit, place: Placement, quantity: str) -> bool:
    """Whether most other joints have about as much of a quantity as one has, beside the gains of their servos.

    Where a model that has no dry friction at all is given some, one joint's passes any yardstick first. Joints for which the
    quantity is published say nothing of one for which it is not.
    """
    fitted, model, effect = fit.space.mapping(fit.values), problem.robot.model, load("effects", place.effect.name, Effect)

    def share(one: Placement) -> float:
        return fitted[one.full_name(quantity)] / max(position_gain(model, one.targets[0]), 1e-9)

    def is_published(one: Placement) -> bool:
        return any(p.name == quantity and p.start > 0.0 for p in effect.parameters(model, one.targets))

    others = [p for p in fit.objective.simulated.placements if p.effect.name == effect.name and p.targets != place.targets]
    others = [] if any(map(is_published, others)) else others
    alike = sum(share(one) >= ALIKE * share(place) for one in others)
    return len(others) >= FEW and alike > len(others) / 2


def is_strange(parameter: Parameter, interval: tuple[float, float]) -> bool:
    """Whether a number's interval excludes what may be expected about its published value."""
    if parameter.guessed:
        return False
    yardstick = 0.02 * (parameter.high - parameter.low) if parameter.scale == "linear" else 0.0
    return interval[0] > ORDINARY[1] * parameter.start + yardstick or interval[1] < ORDINARY[0] * parameter.start - yardstick


def share_of(fit: Fit, name: str, gain: str, usual: float) -> tuple[float, float]:
    """95 % interval of a damping [N m s/rad] as it would be at the published gain, which is known better where one factor on both
    changes little.

    Args:
        fit: both numbers.
        name: full name of the damping; `gain`: of the gain.
        usual: the gain as a multiple of the published one.
    """
    both = [fit.space.names.index(one) for one in (name, gain)]

    def share(unit: Float[np.ndarray, "P"]) -> float:
        damping, stiffness = fit.space.from_unit(unit)[both]
        return float(damping / stiffness)

    at, half = share(fit.unit), _half_width(fit, both, share)
    published = float(fit.values[both[1]]) / usual
    return published * (at - half), published * (at + half)


def own_damping(fit: Fit, place: Placement) -> tuple[float, float]:
    """95 % interval of a joint's own damping [N m s/rad], where the servo's share of the whole is a number, too (`inside`).

    The two may be known far better together than each by itself: a servo's damping goes with its gain, the joint's does not.
    """
    names = fit.space.names
    moved = [names.index(place.full_name(quantity)) for quantity in ("damping", "inside")]

    def own(unit: Float[np.ndarray, "P"]) -> float:
        both, inside = fit.space.from_unit(unit)[moved]
        return float(both * (1.0 - inside))

    half = _half_width(fit, moved, own)
    return max(own(fit.unit) - half, 0.0), own(fit.unit) + half


def _half_width(fit: Fit, moved: Sequence[int], of: Callable[[np.ndarray], float]) -> float:
    """Half of the 95 % interval of what depends on some numbers, given by their columns.

    Source: Oehlert, The American Statistician 46(1), 1992 (delta method).
    """
    slope = np.zeros(len(fit.unit))
    for at in moved:
        away = np.where(np.arange(len(fit.unit)) == at, NUDGE, 0.0)
        slope[at] = (of(fit.unit + away) - of(fit.unit - away)) / (2.0 * NUDGE)
    return SURE * float(np.sqrt(max(slope @ fit.covariance() @ slope, 0.0)))


def is_own_damping_strange(model: mujoco.MjModel, joint: str, interval: tuple[float, float]) -> bool:
    """Whether the interval of a joint's own damping excludes what may be expected.

    What brakes the joint itself, damping or a drag, is no servo's, whatever its gain is: a servo that seems to damp less can make
    up for it in the sum of both alone.
    """
    low, high = ordinary_own_damping(model, joint)
    return interval[0] > high or interval[1] < low
