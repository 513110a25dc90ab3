"""Two effects of one joint found at once, in stretches so short that errors cannot grow in them.

Where a servo reaches its limit, whole motions have a false valley for every set of numbers, and two effects on its joint lead each
other there: neither is found before the other. Restarted at measured states every fifth of a second, a model is off by little more
than its torques are, and that has few valleys. Source: Bock, Recent Advances in Parameter Identification Techniques for O.D.E.,
1983 (multiple shooting).
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from edream.catalog import load
from edream.core.effect import Effect
from edream.diagnosis.backward import refitted_without, without
from edream.diagnosis.candidates import Candidate, library
from edream.diagnosis.creep import TOGETHER, creeping
from edream.diagnosis.descent import Fit, begin, descend, polish
from edream.diagnosis.few import ENOUGH, thinned
from edream.diagnosis.left_out import left_out_errors, worst_joint
from edream.diagnosis.nearest import as_much_as, begun_in_all_strengths, from_nearest, moving
from edream.diagnosis.problem import Problem
from edream.diagnosis.screen import Scored
from edream.diagnosis.side_by_side import side_by_side
from edream.diagnosis.starts import as_published, in_all_strengths_beside_published, of_joints
from edream.diagnosis.trials import Trial, judged, on_stretches

SHORT = 0.2  # s
LEADS = 3  # of what is nearest alone
USUAL, ARRIVING, CLOSE = 8, 20, 1e-3  # steps, and the relative gain below which the last ones have arrived
AS_NEAR = 1.1  # times the error of an effect: its special case is as near


@dataclass(frozen=True, eq=False)
class Pair:
    """Two effects of one joint.

    Attributes:
        problem: with friction that creeps, where they ask for that.
        first: the one that closes more alone, fitted alone.
        second: the other beside it.
    """

    problem: Problem
    first: Trial
    second: Trial


def both_at_once(problem: Problem, fit: Fit, errors: Float[np.ndarray, "M"]) -> Pair | None:
    """The two effects that together are nearest to short stretches of the joint that is off most; None where there are no two.

    Args:
        problem: robot, motions and settings.
        fit: with neither, on whole motions.
        errors: of motions left out, with neither [rad^2], (M,).
    """
    joint, searched = worst_joint(problem, fit), without_past(problem)
    usual = _with_own_numbers_anew(problem, on_stretches(problem, thinned(fit, ENOUGH), SHORT), joint)
    pairs = [
        (near, (one.candidate, other.candidate))
        for single, one in _leads(searched, usual, joint)
        for near, other in begun_in_all_strengths(searched, single, [(joint,)], in_all_strengths_beside_published)
    ]
    if not pairs:
        return None
    near, both = _plainest(searched, *min(pairs, key=lambda pair: pair[0].rms))
    begun = begin(replace(fit.objective, simulated=near.objective.simulated, simulations=0), near.unit)
    problem, end = _with_creep(problem, polish(descend(begun, None, ARRIVING, CLOSE)))
    alone = [
        judged(problem, refitted_without(problem, end, gone), errors, Scored(kept, {}, 0.0)) for kept, gone in (both, both[::-1])
    ]
    first = max(alone, key=lambda trial: trial.closed)
    second = next(candidate for candidate in both if candidate != first.candidate)
    return Pair(problem, first, judged(problem, end, first.errors, Scored(second, {}, 0.0)))


def _plainest(problem: Problem, near: Fit, both: tuple[Candidate, Candidate]) -> tuple[Fit, tuple[Candidate, Candidate]]:
    """Two effects on short stretches, gone down to their end, each as its special case where that is as near."""
    near, found = descend(near, None, ARRIVING, CLOSE), list(both)
    for at, candidate in enumerate(both):
        special = load("effects", candidate.effect, Effect).special
        plain = Candidate(special[0], candidate.targets) if special else candidate
        if plain in found:
            continue
        again = from_nearest(problem, without(near, candidate), Scored(plain, {}, 0.0), as_much_as(near, candidate), ARRIVING)
        if again.rms <= AS_NEAR * near.rms:
            near, found[at] = again, plain
    return near, (found[0], found[1])


def _with_creep(problem: Problem, end: Fit) -> tuple[Problem, Fit]:
    """Two effects on whole motions, beside friction that creeps where that leaves less than half of what they do."""
    errors = left_out_errors(problem, end)
    softer = creeping(problem, end, errors)
    floor = problem.floor**2
    if softer is None or softer.errors.mean() - floor > TOGETHER * (errors.mean() - floor):
        return problem, end
    return softer.problem, polish(descend(softer.fit, None, ARRIVING, CLOSE))


def without_past(problem: Problem) -> Problem:
    """The problem without effects that show readings of before: a stretch that begins at one repeats what was read."""
    past = tuple(effect.name for effect in library(problem) if effect.reads_past)
    return replace(problem, settings=replace(problem.settings, ignored=(*problem.settings.ignored, *past)))


def _with_own_numbers_anew(problem: Problem, fit: Fit, joint: str) -> Fit:
    """The fit, the numbers of one joint gone down from the published ones."""
    own, space = frozenset({joint}), fit.space
    plain = as_published(problem, space.names, fit.values, own)
    return descend(begin(fit.objective, np.clip(space.to_unit(plain), 0.0, 1.0)), of_joints(fit.objective, own), USUAL)


def _leads(problem: Problem, usual: Fit, joint: str) -> list[tuple[Fit, Scored]]:
    """What is nearest alone, gone down to its end."""
    begun = sorted(
        begun_in_all_strengths(problem, usual, [(joint,)], in_all_strengths_beside_published), key=lambda pair: pair[0].rms
    )

    def arrived(pair: tuple[Fit, Scored]) -> tuple[Fit, Scored]:
        near, one = pair
        return descend(near, moving(usual, near.objective, one.candidate), ARRIVING, CLOSE), one

    return list(side_by_side(arrived, begun[:LEADS], problem.settings.threads))
