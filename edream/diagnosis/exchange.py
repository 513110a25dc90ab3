"""Names that give way to what they are confused with, once others stand beside them."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from edream.diagnosis.backward import passes, refitted_without, without
from edream.diagnosis.candidates import confused_with, placement
from edream.diagnosis.decide import Round
from edream.diagnosis.descent import Fit, descend, polish
from edream.diagnosis.left_out import HALF, bootstrap, left_out_errors
from edream.diagnosis.problem import Problem
from edream.diagnosis.screen import Scored, extend
from edream.diagnosis.side_by_side import side_by_side
from edream.diagnosis.starts import in_all_strengths, in_all_strengths_beside_published
from edream.diagnosis.trials import ARRIVING, Trial, by_nearness, descend_from, judged, placed_at

LEFT = 1.3  # floors of error beside all names, from which one of them may be a stand-in


def exchanged(problem: Problem, fit: Fit, rounds: Sequence[Round]) -> tuple[Fit, list[Round], list[tuple[str, Fit]]]:
    """Where several names leave a gap, each gives way to what it is confused with and closes half of that beside the others.

    A lag beside damping and inertia goes slowly, and looked less like what was missing than a delay as long as a second effect
    was missing, too.

    Returns:
        The fit, the rounds with what was taken instead, and each exchange in words with the model after it.
    """
    out, told = list(rounds), list[tuple[str, Fit]]()
    if sum(one.taken is not None for one in rounds) < 2:
        return fit, out, told
    for number, one in enumerate(rounds):
        if one.taken is None or fit.rms <= LEFT * problem.floor:
            continue
        bare = refitted_without(problem, fit, one.taken.candidate)
        errors = left_out_errors(problem, bare)
        old = judged(problem, fit, errors, one.taken)
        others = instead(problem, fit, errors, old)
        new = next((t for t in others if passes(problem, t) and is_better(problem, t, old)), None)
        if new is not None:
            fit = new.fit
            out[number] = replace(one, trials=sorted([*others, old], key=lambda t: -t.closed), taken=new)
            told.append((f"{new.candidate.label} for {old.candidate.label}", fit))
    return fit, out, told


def instead(problem: Problem, fit: Fit, errors: Float[np.ndarray, "M"], old: Trial) -> list[Trial]:
    """What a name is confused with, in its place beside all others, each gone down to its end; best first.

    `errors` are those of motions left out [rad^2], (M,), without it.
    """
    bare = without(fit, old.candidate)
    twins = placed_at(problem, bare, old.candidate.targets, confused_with(problem, old.candidate.effect))

    def gone_down(start: Float[np.ndarray, "P"], one: Scored) -> Fit:
        extended, _ = extend(bare, [placement(problem, one.candidate)])
        return descend(descend_from(bare, extended, start, one.candidate, ARRIVING), None, ARRIVING)

    def ended(one: Scored) -> Trial:
        """From usual numbers as they are and as published: those that made up for the name's own form lead nowhere else."""
        starts = [by_nearness(problem, bare, [one], of)[0][1] for of in (in_all_strengths, in_all_strengths_beside_published)]
        return judged(problem, polish(min((gone_down(start, one) for start in starts), key=lambda end: end.rms)), errors, one)

    return sorted(side_by_side(ended, twins, problem.settings.threads), key=lambda t: -t.closed)


def is_better(problem: Problem, new: Trial, old: Trial) -> bool:
    """Whether motions left out surely speak for one of two trials, and it closes half of what the other leaves above the floor."""
    gain, left = old.errors - new.errors, float(old.errors.mean()) - problem.floor**2
    low, _ = bootstrap(gain, problem.settings.seed)
    return low > 0.0 and float(gain.mean()) >= HALF * left
