"""Which joints of a group an effect is on: a candidate over several joints may have been carried by some of them alone."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from edream.catalog import load
from edream.core.effect import Effect
from edream.diagnosis.candidates import Candidate, drive_of, placement
from edream.diagnosis.descent import Fit, begin, descend, polish
from edream.diagnosis.problem import Problem
from edream.diagnosis.screen import extend
from edream.diagnosis.trials import Trial, judged

NEARER = 0.5  # of the way from absence to the group's value: below it a joint's own value speaks against the group's


def narrowed(problem: Problem, before: Fit, errors: Float[np.ndarray, "M"], taken: Trial, ended: Fit) -> tuple[Trial, Fit] | None:
    """The effect on those joints of its group alone that numbers of their own show it on; None where that is all of them, or none.

    Joints with one published drive share their hardware, and one that motions say nothing about stays with the others; it goes
    where they speak against it. Joints with different drives stay where motions speak for them.

    Args:
        before: the fit without the effect.
        errors: of that fit on motions left out, (M,).
        taken: the effect on the group, its search at `ended`.
    """
    group, effect = taken.candidate.targets, load("effects", taken.candidate.effect, Effect)
    if len(group) < 2 or effect.place != "joint" or group in problem.groups:
        return None
    shared, telling = _numbers(problem, taken.candidate, ended)
    own = _apart(problem, before, taken.candidate, ended, shared)
    same = len({drive_of(problem.robot.model, joint) for joint in group}) == 1
    kept = tuple(joint for joint in group if _stays(problem, Candidate(effect.name, (joint,)), own, telling, same))
    if not kept or kept == group:
        return None
    fewer = Candidate(effect.name, kept)
    fit = polish(descend(_begun(problem, before, [fewer], ended, shared), None, 4))
    return judged(problem, fit, errors, replace(taken, candidate=fewer)), fit


def _apart(problem: Problem, before: Fit, candidate: Candidate, ended: Fit, shared: dict[str, float]) -> Fit:
    """The effect with numbers of its own on each joint of its group, gone down from those that they shared."""
    single = [Candidate(candidate.effect, (joint,)) for joint in candidate.targets]
    return polish(descend(_begun(problem, before, single, ended, shared), None, 4))


def _begun(problem: Problem, before: Fit, candidates: list[Candidate], ended: Fit, shared: dict[str, float]) -> Fit:
    """The model with these candidates, each at the shared numbers, all else where the group's search ended."""
    places = [placement(problem, one) for one in candidates]
    extended, _ = extend(before, places)
    space, found = extended.simulated.space, ended.space.mapping(ended.values)
    found |= {place.full_name(name): value for place in places for name, value in shared.items()}
    unit = space.to_unit(np.array([found[name] for name in space.names]))
    return begin(extended, np.clip(unit, 0.0, 1.0))


def _numbers(problem: Problem, candidate: Candidate, fit: Fit) -> tuple[dict[str, float], dict[str, float]]:
    """Quantities of a candidate by their short names, and those of them alone whose interval excludes their absence."""
    place, found, intervals = placement(problem, candidate), fit.space.mapping(fit.values), fit.intervals()
    shared, telling = {}, {}
    for parameter in place.effect.parameters(problem.robot.model, place.targets):
        name = place.full_name(parameter.name)
        low, high = intervals[name]
        shared[parameter.name] = found[name]
        if parameter.absent is not None and not low <= parameter.absent <= high:
            telling[parameter.name] = found[name]
    return shared, telling


def _stays(problem: Problem, single: Candidate, own: Fit, telling: dict[str, float], same: bool) -> bool:
    """Whether one joint's own numbers speak for the group's, or, where the joint is of the same hardware, not against them."""
    place, intervals, found = placement(problem, single), own.intervals(), own.space.mapping(own.values)
    for parameter in place.effect.parameters(problem.robot.model, place.targets):
        if parameter.absent is None or parameter.name not in telling:
            continue
        name, group = place.full_name(parameter.name), telling[parameter.name]
        low, high = intervals[name]
        near = (found[name] - parameter.absent) / (group - parameter.absent) >= NEARER
        if (near and not low <= parameter.absent <= high) or (same and (near or low <= group <= high)):
            return True
    return False
