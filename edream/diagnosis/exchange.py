"""Names that give way to what they are confused with, once others stand beside them."""

from collections.abc import Callable, Sequence
from dataclasses import replace

from edream.diagnosis.backward import passes, refitted_without, without
from edream.diagnosis.candidates import Candidate, acted_on, confused_with
from edream.diagnosis.decide import Round
from edream.diagnosis.descent import Fit, descend, polish
from edream.diagnosis.left_out import HALF, bootstrap, left_out_errors
from edream.diagnosis.nearest import ARRIVING, from_nearest, placed_at
from edream.diagnosis.problem import Problem
from edream.diagnosis.screen import Scored
from edream.diagnosis.side_by_side import side_by_side
from edream.diagnosis.starts import in_all_strengths, in_all_strengths_beside_published
from edream.diagnosis.trials import Trial, gone_on, judged, on_few

LEFT = 1.3  # floors of error beside all names, from which one of them may be a stand-in
HOPEFUL = 0.7  # of the squared error above the floor: what leaves more on few motions is not gone on with


def exchanged(
    problem: Problem, fit: Fit, rounds: Sequence[Round], done: Callable[[int], object] = lambda n: None
) -> tuple[Fit, list[Round], list[tuple[str, Fit]]]:
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
        ends = instead(problem, fit, one.taken.candidate)
        done(1)
        if not ends:
            continue
        errors = left_out_errors(problem, refitted_without(problem, fit, one.taken.candidate))
        old = judged(problem, fit, errors, one.taken)
        others = sorted((judged(problem, polish(end), errors, twin) for end, twin in ends), key=lambda t: -t.closed)
        new = next((t for t in others if passes(problem, t) and is_better(problem, t, old)), None)
        if new is not None:
            fit = new.fit
            out[number] = replace(one, trials=sorted([*others, old], key=lambda t: -t.closed), taken=new)
            told.append((f"{new.candidate.label} instead", fit))
    return fit, out, told


def instead(problem: Problem, fit: Fit, name: Candidate) -> list[tuple[Fit, Scored]]:
    """What a name is confused with in its place beside all others, where that closes nearly half of what is left on few motions.

    Each is begun beside the usual numbers as they are and as published: those that made up for the name's form lead nowhere else.
    """
    bare = without(fit, name)
    few, known = on_few(problem, bare), on_few(problem, fit)
    least = problem.floor**2 + HOPEFUL * (known.rms**2 - problem.floor**2)
    twins = placed_at(problem, bare, name.targets, confused_with(problem, name.effect))

    def gone_down(one: Scored) -> tuple[Fit, Scored]:
        begun = [from_nearest(problem, few, one, of, ARRIVING) for of in (in_all_strengths, in_all_strengths_beside_published)]
        ends = [descend(near, None, ARRIVING) for near in begun]
        return min(ends, key=lambda end: end.rms), one

    found = side_by_side(gone_down, twins, problem.settings.threads)
    return [(gone_on(bare, near, acted_on(one.candidate)), one) for near, one in found if near.rms**2 <= least]


def is_better(problem: Problem, new: Trial, old: Trial) -> bool:
    """Whether motions left out surely speak for one of two trials, and it closes half of what the other leaves above the floor."""
    gain, left = old.errors - new.errors, float(old.errors.mean()) - problem.floor**2
    low, _ = bootstrap(gain, problem.settings.seed)
    return low > 0.0 and float(gain.mean()) >= HALF * left
