"""Candidates begun away from the fitted numbers: in all their strengths, and from the nearest of these gone down."""

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Bool, Float

from edream.core.effect import Effect
from edream.diagnosis.candidates import Candidate, acted_on, library, on_links, placement, probes_of, rounds
from edream.diagnosis.descent import Fit, begin, descend
from edream.diagnosis.left_out import worst_joint
from edream.diagnosis.problem import Problem
from edream.diagnosis.screen import Scored, acts_already, extend, fits_beside, with_quantities
from edream.diagnosis.side_by_side import side_by_side
from edream.diagnosis.starts import fresh_columns, in_all_strengths, of_joints, with_column
from edream.sim.objective import Objective, rms
from edream.sim.simulation import Placement

ARRIVING = 6  # steps from published numbers, which may be far away, for a candidate to show what it can
NEAREST, LEADING = 10, 4  # in some strength: they are gone down from there, and those that lead after the first steps go on
FIRST = 2  # steps, after which a candidate that is right leads

# (problem, candidate, objective with it, values [P] where it is absent) -> values [P], in the parameters' units
Starts = Callable[[Problem, Placement, Objective, Float[np.ndarray, "P"]], list[Float[np.ndarray, "P"]]]


def begun_in_all_strengths(
    problem: Problem, fit: Fit, groups: Sequence[tuple[str, ...]], starts_of: Starts
) -> list[tuple[Fit, Scored]]:
    """What is nearest to the motions in some strength, gone down from there, on the group that is off most.

    Where servos reach their limits, little of an effect does nothing, or what much of it does not, and numbers in a false valley
    that made up for what is missing tell the score test nothing. Where others have made up for it, the right one is not the nearest
    before its numbers have moved: what leads after the first steps goes on.
    """
    there = [group for group in groups if worst_joint(problem, fit) in group]
    if not there:
        return []
    nearest = by_nearness(problem, fit, reaching(problem, fit, there[0]), starts_of)[:NEAREST]

    def gone_down(found: tuple[float, Float[np.ndarray, "P"], Scored], iterations: int) -> tuple[Fit, Scored]:
        _, start, one = found
        extended, _ = extend(fit, [placement(problem, one.candidate)])
        return descend_from(fit, extended, start, one.candidate, iterations), one

    def gone_on(begun: tuple[Fit, Scored]) -> tuple[Fit, Scored]:
        near, one = begun
        return descend(near, moving(fit, near.objective, one.candidate), ARRIVING - FIRST), one

    threads = problem.settings.threads
    begun = side_by_side(lambda found: gone_down(found, FIRST), nearest, threads)
    return list(side_by_side(gone_on, sorted(begun, key=lambda pair: pair[0].rms)[:LEADING], threads))


def by_nearness(
    problem: Problem, fit: Fit, places: Sequence[Scored], starts_of: Starts
) -> list[tuple[float, Float[np.ndarray, "P"], Scored]]:
    """Candidates, each with the nearest of its starts and its error [rad]; nearest first."""

    def nearest(one: Scored) -> tuple[float, Float[np.ndarray, "P"], Scored]:
        place = placement(problem, one.candidate)
        extended, absent = extend(fit, [place])
        starts = np.array(starts_of(problem, place, extended, absent))
        errors = [rms(r) for r in extended.residuals(starts)]
        best = int(np.argmin(errors))
        return errors[best], starts[best], one

    return sorted(side_by_side(nearest, places, problem.settings.threads), key=lambda found: found[0])


def descend_from(fit: Fit, extended: Objective, start: Float[np.ndarray, "P"], candidate: Candidate, iterations: int) -> Fit:
    """A candidate gone down from away from the fitted numbers, where columns that were fitted without it say little."""
    fresh = moving(fit, extended, candidate)
    if fresh is None:
        return descend(begin(extended, np.clip(extended.simulated.space.to_unit(start), 0.0, 1.0)), None, iterations)
    return descend(with_column(fit, extended, start, fresh), fresh, iterations)


def moving(fit: Fit, extended: Objective, candidate: Candidate) -> Bool[np.ndarray, "P"] | None:
    """Which numbers are differenced anew with a candidate: its own and its joints'; None where it acts on all joints' numbers."""
    joints = acted_on(candidate)
    return fresh_columns(fit, extended) | of_joints(extended, joints) if joints else None


def from_nearest(problem: Problem, fit: Fit, one: Scored, starts_of: Starts, iterations: int) -> Fit:
    """A candidate gone down from the nearest of its starts."""
    _, start, _ = by_nearness(problem, fit, [one], starts_of)[0]
    extended, _ = extend(fit, [placement(problem, one.candidate)])
    return descend_from(fit, extended, start, one.candidate, iterations)


def reaching(problem: Problem, fit: Fit, group: tuple[str, ...]) -> list[Scored]:
    """What can act on a group of joints, on a link that they carry, or on the world, and does not yet."""
    effects = library(problem)
    links = [(c.targets, effect) for effect in effects for c in on_links(problem, frozenset(group), effect)]
    spots = [(group, effects), *((targets, [effect]) for targets, effect in links), ((), effects)]
    return [one for targets, some in spots for one in placed_at(problem, fit, targets, some)]


def placed_at(problem: Problem, fit: Fit, targets: Sequence[str], effects: Sequence[Effect]) -> list[Scored]:
    """Those of some effects that can act on these joints and do not yet, begun at their first probes."""
    there = dict.fromkeys(c for one in rounds(problem, effects) for c in one if c.targets == tuple(targets))
    fresh = [c for c in there if not acts_already(c, fit.objective.simulated.placements) and fits_beside(problem, fit, [c])]
    return [Scored(c, probes_of(problem, placement(problem, c))[0], 0.0) for c in fresh]


def as_much_as(fit: Fit, other: Candidate) -> Starts:
    """Starts of an effect in all its strengths and, first, with the quantities of another one in a fit, as far as it has them.

    A more general form, or one that moves the joint alike, is as strong as what is looked for, in strengths that no probe may have.
    """

    def starts(
        problem: Problem, place: Placement, extended: Objective, absent: Float[np.ndarray, "P"]
    ) -> list[Float[np.ndarray, "P"]]:
        own, found = placement(problem, other), fit.space.mapping(fit.values)
        same = {
            p.name: float(np.clip(found[own.full_name(p.name)], p.low, p.high))
            for p in place.effect.parameters(problem.robot.model, place.targets)
            if own.full_name(p.name) in found
        }
        begun = in_all_strengths(problem, place, extended, absent)
        return [with_quantities(extended, absent, [place], [same]), *begun] if same else begun

    return starts
