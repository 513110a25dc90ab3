"""What a name may be instead, and doubts of first rounds asked again once other names stand beside them."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from jaxtyping import Float

from edream.diagnosis.backward import refitted_without, without
from edream.diagnosis.candidates import Candidate, placement
from edream.diagnosis.decide import ALIKE, Round, meets_as_well, rivals
from edream.diagnosis.descent import Fit, begin, descend, polish
from edream.diagnosis.left_out import HALF, gap_above_floor, left_out_errors
from edream.diagnosis.nearest import ARRIVING
from edream.diagnosis.problem import Problem
from edream.diagnosis.screen import extend
from edream.diagnosis.side_by_side import side_by_side
from edream.diagnosis.starts import beside_either, in_all_strengths
from edream.diagnosis.trials import Trial, is_another, judged, on_few
from edream.sim.objective import rms

STARTS = 2  # of a rival, the nearest, gone down from
BEHIND = 2.0  # times the name's error: a rival that is left with more is told from it, wherever its valley ends


def others_of(problem: Problem, own: Round, trial: Trial, named: Sequence[Candidate]) -> list[tuple[Trial, bool]]:
    """A name's rivals in its round, and whether motions tell each from it; what is named beside it is no alternative to it."""
    return [(other, told) for other, told in rivals(problem, own.trials, trial) if other.candidate not in named]


def doubtful(problem: Problem, own: Round, trial: Trial, named: Sequence[Candidate]) -> list[Trial]:
    """The rivals that these motions cannot tell from a name."""
    return [
        other
        for other, told in others_of(problem, own, trial, named)
        if not told and is_another(other, trial) and (other.closed >= ALIKE * trial.closed or meets_as_well(other, trial))
    ]


def asked_again(
    problem: Problem, fit: Fit, rounds: Sequence[Round], trials: Sequence[Trial], left: Float[np.ndarray, "M"]
) -> tuple[list[Trial], list[Round]]:
    """The names and their rounds; what a name was not told from before others were known is put in its place beside these.

    A base that leans and a spring moved a joint alike as long as its dead zone was missing. The last name's rivals stood beside
    all others already, and are asked again only where its own search has gone far since: a payload half-way to its end did no
    better than a spring, and left nothing there.

    Args:
        problem: robot, motions and settings.
        fit: with all names.
        rounds: that took them.
        trials: the names.
        left: errors on motions left out [rad^2], (M,), beside all names.
    """
    names, out, named = list(trials), list(rounds), [t.candidate for t in trials]
    for place, trial in enumerate(names):
        if place == len(names) - 1 and not has_gone_far(problem, trial.errors, left):
            continue
        number = next(i for i, one in enumerate(out) if one.taken is trial)
        if others := doubtful(problem, out[number], trial, named):
            out[number], names[place] = held_against(problem, fit, out[number], trial, others)
    return names, out


def has_gone_far(problem: Problem, errors: Float[np.ndarray, "M"], left: Float[np.ndarray, "M"]) -> bool:
    """Whether what is left on motions left out [rad^2], (M,), is less than half of what was when a name was judged."""
    return gap_above_floor(problem, left) < HALF * gap_above_floor(problem, errors)


def held_against(
    problem: Problem, fit: Fit, own: Round, name: Trial, others: Sequence[Trial], behind: float = BEHIND
) -> tuple[Round, Trial]:
    """A round as it is beside all that a fit names, and its name there, judged by the gap that is left without it.

    Args:
        problem: robot, motions and settings.
        fit: with all names.
        own: the round that took the name.
        name: what it took.
        others: rivals, each put in the name's place.
        behind: times the fit's error that a rival may leave on first looks to go to its end.
    """
    bare = refitted_without(problem, fit, name.candidate)
    errors = left_out_errors(problem, bare)
    put = partial(in_place, problem, fit, name.candidate, behind=behind)
    ends = side_by_side(put, others, problem.settings.threads)
    rivals = [judged(problem, end, errors, other) for end, other in zip(ends, others, strict=True)]
    beside = judged(problem, fit, errors, name)
    trials = sorted([beside, *rivals], key=lambda t: -t.closed)
    return replace(own, before=bare, errors=errors, trials=trials, taken=beside), beside


def in_place(problem: Problem, fit: Fit, name: Candidate, rival: Trial, behind: float = BEHIND) -> Fit:
    """The fit with a rival in the place of a name, gone down from where the rival had ended, or from its strengths.

    That is done on as much motion as first looks take; what is left with no more than so many times the fit's error goes on on all.
    """
    bare, place = without(fit, name), placement(problem, rival.candidate)
    extended, absent = extend(bare, [place])
    few, _ = extend(on_few(problem, bare), [place])
    space, ended = extended.simulated.space, rival.fit.space.mapping(rival.fit.values)
    either = beside_either(problem, place, extended, absent, ended)
    starts = np.array([*either, *in_all_strengths(problem, place, extended, absent)])
    nearest = np.argsort([rms(r) for r in few.residuals(starts)])[:STARTS]
    ends = [descend(begin(few, np.clip(space.to_unit(starts[i]), 0.0, 1.0)), None, ARRIVING) for i in nearest]
    end = begin(extended, min(ends, key=lambda end: end.rms).unit)
    return end if end.rms > behind * fit.rms else polish(end)
