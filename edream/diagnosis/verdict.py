"""From evidence to a sentence: named, none, cannot tell, or unnamed."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import dropwhile

import numpy as np
from jaxtyping import Float

from edream.catalog import load
from edream.core.effect import Effect
from edream.diagnosis.alone import explained, off_on, searched
from edream.diagnosis.backward import backward, refitted_without, stands, still_standing
from edream.diagnosis.candidates import Candidate, placement, standing
from edream.diagnosis.decide import Round
from edream.diagnosis.descent import Fit, polish, with_true_slopes
from edream.diagnosis.doubts import asked_again, doubtful, others_of
from edream.diagnosis.exchange import exchanged
from edream.diagnosis.finer import with_plain
from edream.diagnosis.left_out import (
    SEEN_ORDINARY,
    bootstrap,
    does_better,
    falls_short,
    is_clear,
    is_real,
)
from edream.diagnosis.naming import Named, as_written, numbers_of, strange_numbers
from edream.diagnosis.never_fitted import (
    agreement,
    is_contradicted,
    is_left,
    on_others,
    proof_errors,
    proof_squares,
    still_off,
    unstable_on,
)
from edream.diagnosis.nuisance import published
from edream.diagnosis.problem import Problem, nuisance_placements
from edream.diagnosis.remainder import Remainder, find_remainder
from edream.diagnosis.steps import for_a_plain_loop, in_a_plain_loop
from edream.diagnosis.suspects import Suspect, find_suspects, most_ordinary, what_stays, with_ordinary_numbers
from edream.diagnosis.trials import Trial, is_another, judged, predicted
from edream.diagnosis.wording import Verdict, contradicted, on_creep, on_steps, on_the_odd_one, sentence, where_it_shows
from edream.sim.objective import rms
from edream.sim.robot import RobotModel

CLOSED = 0.9  # share of the gap, in root-mean-square error, from which what is left is not worth a formula
# of the squared gap that names leave: where a formula leaves less, one name, or several, are not the whole answer
REST, HALF = 1.0 / 3.0, 0.5
AS_GOOD = 1.1  # times the error of names and a formula that a formula alone may have and be preferred


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """What was found, and the evidence.

    Attributes:
        problem: what was worked on, its robot with the time step that is written.
        searched: the robot with the time step that was searched with.
        verdict: the outcome.
        sentence: the outcome in words.
        effects: what is missing.
        before: the model with nuisance numbers fitted, without what is named (`without_numbers`, where that is in the numbers);
            `after`: with the named effects (and the remainder's term, if any).
        published_rms, before_rms, after_rms: error [rad] on motions that were never fitted.
        unstable: those of them on which the published model is unstable, so that no error of it counts.
        rounds: every forward step with its candidates.
        ladder: label of each step and the error [rad] on each never-fitted motion, (M,).
        remainder: what is left described by a formula, where it has no name.
        contenders: label and fit of each model that these motions cannot tell from another; empty where they can.
        aside: motions that were set aside, since what they alone show nothing explains.
    """

    problem: Problem
    searched: RobotModel
    verdict: Verdict
    sentence: str
    effects: tuple[Named, ...]
    before: Fit
    after: Fit
    published_rms: float
    before_rms: float
    after_rms: float
    unstable: tuple[str, ...]
    rounds: Sequence[Round]
    ladder: Sequence[tuple[str, Float[np.ndarray, "M"]]]
    remainder: Remainder | None
    contenders: Sequence[tuple[str, Fit]]
    aside: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Found:
    """What a search ended in: names that stand, numbers that are strange beside them, and what may hide in those.

    Attributes:
        before: the model with its usual numbers alone.
        fit: with what is named.
        trials, heard: the effects that stand, and the rounds that say what they were compared with.
        left: errors on motions left out [rad^2], (M,).
        short: whether a real gap is left open, most of it or, where nothing stands, any.
        numbers: usual numbers that are strange, where that is a finding.
        suspects: effects that would make them ordinary, most relieving first.
    """

    before: Fit
    fit: Fit
    trials: Sequence[Trial]
    heard: Sequence[Round]
    left: Float[np.ndarray, "M"]
    short: bool
    numbers: Sequence[Named] = ()
    suspects: Sequence[Suspect] = ()

    @property
    def ended(self) -> Fit:
        """What is named is what is written, with the ordinary numbers that it leaves."""
        return self.suspects[0].fit if self.suspects else self.fit


def diagnose(problem: Problem, done: Callable[[str, int], object] = lambda text, n: None) -> Diagnosis:
    """The whole diagnosis of one problem.

    Args:
        problem: robot, motions and settings.
        done: called with what is under way and how many units of it are finished.
    """
    plain = published(in_a_plain_loop(problem))
    start = Fit(plain, np.zeros(0), np.zeros(0), np.zeros((0, 0)), 1.0)
    unstable = unstable_on(problem, start)
    search = searched(problem, done)
    problem, rounds = search.problem, search.rounds
    steps = [("published", start), ("calibrated", rounds[0].before)]
    steps += [(_label(one.taken.candidate), one.taken.fit) for one in rounds if one.taken is not None]
    fit, rounds, told = exchanged(problem, search.fit, rounds, lambda n: done("exchanging names", n))
    steps += told
    found = what_stands(problem, rounds[0].before, fit, rounds)
    found = behind_numbers(problem, found, rounds[0].errors, done)
    trials, heard = asked_again(problem, found.fit, found.heard, found.trials, found.left)
    found = replace(found, trials=trials, heard=heard)
    done("asking doubts again", 1)
    effects, also = named_effects(problem, found)
    remainder = rounds[0].formula or unexplained(problem, found.before, found.fit, rounds[0].errors, found.left, trials)
    done("remainder", 1)
    possible, fit = contenders(found, effects), found.fit
    if remainder is not None:
        fit = remainder.fit
        effects = [one for one in effects if remainder.beside_names]
        steps.append(("remainder", fit))
    elif also:
        if not trials:
            steps[1] = ("calibrated", found.before)
        fit = found.ended
        more = f" and {len(also) - 1} more" if len(also) > 1 else ""
        steps.append((f"+ {also[0]}{more}", fit))
    alone = explained(problem, fit, search.odd) if search.odd is not None and remainder is None else None
    if alone is not None:
        problem, fit, possible = alone.problem, alone.fit, alone.contenders or possible
        steps.append((_label(Candidate(alone.named.name, alone.named.targets)), fit))
    written, fit = for_a_plain_loop(problem, fit)
    proof = proof_squares(problem, fit)
    after = np.sqrt(proof.mean(axis=1))
    ladder = [*((label, np.sqrt(proof_errors(problem, one))) for label, one in steps[:-1]), (steps[-1][0], after)]
    refuted = remainder is None and bool(trials) and is_contradicted(problem, found.left, found.before, found.fit, proof)
    effects = [as_written(one, found.ended, fit) for one in effects]
    effects += [as_written(alone.named, alone.fit, fit)] if alone is not None else []
    verdict = judge(effects, remainder, found.short or refuted or (search.odd is not None and not effects))
    if refuted:
        said = contradicted(effects, problem.robot.joints, on_others(problem, proof))
    elif verdict == "none":
        said = agreement(problem, proof)
    else:
        shows = where_it_shows(problem, found.fit) if found.short and remainder is None else ""
        said = sentence(verdict, effects, remainder, problem.robot.joints, shows) + still_off(problem, proof)
    if search.odd is not None:
        shown, confirmed = (None, False) if alone is None else (alone.named, alone.confirmed)
        said += on_the_odd_one(search.odd.episode.name, shown, confirmed, *off_on(problem, fit, search.odd))
    return Diagnosis(
        problem=written,
        searched=problem.robot,
        verdict=verdict,
        sentence=said + on_creep(problem) + on_steps(problem, written, bool(unstable)),
        effects=tuple(effects),
        before=found.before if effects or remainder else fit,  # with nothing added there is one calibrated model, not two
        after=fit,
        published_rms=rms(ladder[0][1]),
        before_rms=rms(ladder[1][1]),
        after_rms=rms(after),
        unstable=unstable,
        rounds=rounds,
        ladder=ladder,
        remainder=remainder,
        contenders=possible if verdict == "cannot_tell" else (),
        aside=(search.odd.episode.name,) if search.odd is not None and alone is None else (),
    )


def what_stands(problem: Problem, before: Fit, fit: Fit, rounds: Sequence[Round]) -> Found:
    """The names of a forward search that stay once all of them are there, and what they leave."""
    taken = [one.taken for one in rounds if one.taken is not None]
    first = rounds[0].errors
    fit, kept = backward(problem, fit, [t.candidate for t in taken], first)
    if len(kept) < len(taken) or not all(stands(problem, one, fit) for one in kept):
        fit, kept = still_standing(problem, fit, kept)
    fit = with_plain(problem, fit, kept)
    trials, heard = left_alone(problem, fit, rounds, [t for t in taken if t.candidate in kept])
    if not trials:
        return Found(before, fit, trials, heard, first, is_left(problem, first, proof_errors(problem, before)))
    left = predicted(problem, fit, trials[-1] if len(kept) == len(taken) else None)
    return Found(before, fit, trials, heard, left, falls_short(problem, first, left))


def behind_numbers(
    problem: Problem, found: Found, first: Float[np.ndarray, "M"], done: Callable[[str, int], object] = lambda text, n: None
) -> Found:
    """The same with strange numbers, and what may hide in them, where these are a finding.

    Numbers that are strange beside a real gap have made up for it: they are not what is missing. `first` are the errors of motions
    left out [rad^2], (M,), with nothing named.
    """
    before, fit, trials = found.before, found.fit, found.trials
    real = is_real(problem, found.left) if trials else found.short
    if real or not may_hide_more(strange_numbers(problem, fit), bool(trials)):
        return found
    # a search that ends near enough knows less of valleys, and calls its numbers surer than they are
    fit = most_ordinary(problem, fit if fit.ended else polish(fit))
    suspects: list[Suspect] = []
    if numbers := off_nominal(problem, fit):
        strange = [placement(problem, Candidate(n.name, n.targets)).full_name(q) for n in numbers for q in n.values]
        suspects = find_suspects(problem, fit, strange, lambda n: done("looking behind strange numbers", n))
    if suspects and trials:
        suspects, trials = what_stays(problem, trials, suspects, first)
        fit, numbers = (fit, numbers) if trials else (before, [])  # strange only beside what went out: no answer alone
    if (numbers or suspects) and not trials:
        home = without_numbers(problem, fit, numbers, suspects)
        suspects = list(dropwhile(lambda one: not does_better(problem, one.fit, home, SEEN_ORDINARY), suspects))
        if numbers and not suspects:  # what explains them is no better; they may still be what is missing
            home = without_numbers(problem, fit, numbers, [])
            numbers = numbers if does_better(problem, fit, home) else []
        if numbers or suspects:
            before = home
        else:  # ordinary numbers meet motions left out as well, which is no news
            fit = home
    return replace(found, before=before, fit=fit, trials=trials, numbers=numbers, suspects=suspects)


def named_effects(problem: Problem, found: Found) -> tuple[list[Named], list[str]]:
    """What is named, and the labels of what of that is behind strange numbers, or is one."""
    known = with_true_slopes(found.ended) if found.trials else found.ended
    effects = [_named(problem, known, t, found.heard, found.trials) for t in found.trials]
    if found.trials and not found.suspects:  # beside a name, a strange number alone is its own form, which no formula has exactly
        return effects, []
    more = with_suspects(problem, found.numbers, found.suspects)
    return [*effects, *more], [Candidate(one.name, one.targets).label for one in more]


def left_alone(
    problem: Problem, fit: Fit, rounds: Sequence[Round], trials: Sequence[Trial]
) -> tuple[Sequence[Trial], Sequence[Round]]:
    """The effects that stayed, and the rounds that say what they were compared with.

    One that is left alone, and stood beside another when it was taken, has all candidates of the first round for rivals.
    """
    first = rounds[0]
    if len(trials) != 1 or first.taken is None or trials[0].candidate == first.taken.candidate:
        return trials, rounds
    own = judged(problem, fit, first.errors, trials[0])
    others = [t for t in first.trials if t.candidate != own.candidate]
    return [own], [replace(first, trials=sorted([own, *others], key=lambda t: -t.closed), taken=own)]


def without_numbers(problem: Problem, fit: Fit, numbers: Sequence[Named], suspects: Sequence[Suspect]) -> Fit:
    """The model fitted again without what is named, where that is in its numbers: those as published, no others strange instead.

    Args:
        problem: robot, motions and settings.
        fit: the model with its strange numbers.
        numbers: what is strange.
        suspects: effects that would make them ordinary; the first is named instead of them.
    """
    if not suspects:
        fit = refitted_without(problem, fit, *(Candidate(one.name, one.targets) for one in numbers))
    return with_ordinary_numbers(problem, fit)


def contenders(found: Found, effects: Sequence[Named]) -> list[tuple[str, Fit]]:
    """The models that remain possible where the last doubtful effect has rivals: its own and one for each rival."""
    trials, rounds = found.trials, found.heard
    if found.suspects:
        strange = [("strange numbers", found.fit)] if trials or all(one.taken is None for one in rounds) else []
        return [*strange, *((s.candidate.label, s.fit) for s in found.suspects)]
    for trial, named in reversed(list(zip(trials, effects, strict=False))):
        if named.confusable_with:
            own = next(r for r in rounds if r.taken is trial)
            return [(t.candidate.label, t.fit) for t in own.trials if t is trial or t.candidate.label in named.confusable_with]
    return []


def _label(candidate: Candidate) -> str:
    return f"+ {candidate.label}"


def _named(problem: Problem, fit: Fit, trial: Trial, rounds: Sequence[Round], taken: Sequence[Trial]) -> Named:
    own, named = next(r for r in rounds if r.taken is trial), [one.candidate for one in taken]
    alike = tuple(other.candidate.label for other in doubtful(problem, own, trial, named))
    different = [other for other, _ in others_of(problem, own, trial, named) if is_another(other, trial)]
    runner = (different[0].candidate.label, different[0].closed) if different else None
    values, intervals, units = numbers_of(problem, fit, standing(problem, trial.candidate, fit.objective.simulated))
    effect = load("effects", trial.candidate.effect, Effect)
    return Named(effect.name, effect.summary, trial.candidate.targets, values, intervals, units, trial.closed, runner, alike)


def off_nominal(problem: Problem, fit: Fit) -> list[Named]:
    """Nuisance numbers so far from the published ones that they are the finding, where only a few are.

    Where most are off, the model was simply not calibrated, and no single one is news.
    """
    found = strange_numbers(problem, fit)
    count = sum(len(place.parameters(problem.robot.model)) for place in nuisance_placements(problem))
    return found if len(found) <= max(2, count // 4) else []


def may_hide_more(strange: Sequence[Named], beside_names: bool) -> bool:
    """Whether strange numbers are worth a look behind them; beside names only a gain is.

    What hides behind numbers (a weight, a spring, another gear) hides in the gain, too; a rotor or a friction that is strange alone
    is published wrongly, mostly.
    """
    return any(one.name == "servo_gain" or not beside_names for one in strange)


def with_suspects(problem: Problem, numbers: Sequence[Named], suspects: Sequence[Suspect]) -> list[Named]:
    """Strange numbers, or the one effect that would make them ordinary: then that, which they may be confused with."""
    if not suspects:
        return list(numbers)
    best, others = suspects[0], suspects[1:]
    effect = load("effects", best.candidate.effect, Effect)
    values, intervals, units = numbers_of(problem, best.fit, placement(problem, best.candidate))
    rivals_ = (*(Candidate(n.name, n.targets).label for n in numbers), *(s.candidate.label for s in others))
    return [Named(effect.name, effect.summary, best.candidate.targets, values, intervals, units, float("nan"), None, rivals_)]


def unexplained(
    problem: Problem,
    before: Fit,
    fit: Fit,
    first: Float[np.ndarray, "M"],
    left: Float[np.ndarray, "M"],
    trials: Sequence[Trial],
) -> Remainder | None:
    """What has no name: a formula for what the named effects leave, or one that does better alone than all of them together.

    None where the gap is closed, or what is left is small beside what one effect explains, or no formula holds on left-out motions.
    What several effects leave is not small where it is clear. Where several were needed, each of which took what the last one had
    left, they may be stand-ins for something else.
    `first` and `left` are the errors on motions left out, without the named effects and with them.
    """
    start, end, floor = float(first.mean()), float(left.mean()), problem.floor**2
    if not is_real(problem, left):
        return None
    most = np.sqrt(start) - np.sqrt(end) >= CLOSED * (np.sqrt(start) - problem.floor)
    closed = most and bool(trials) and not (len(trials) > 1 and is_clear(problem, left))
    if not closed:
        beside = find_remainder(problem, fit, beside_names=bool(trials))
        if beside is not None and beside.real:
            rest, short = float(beside.errors.mean()), falls_short(problem, first, left)
            if trials and short and (alone := find_remainder(problem, before)) is not None and alone.real:
                return alone if float(alone.errors.mean()) <= AS_GOOD * rest else beside
            if not trials or short or rest - floor < (REST if len(trials) == 1 else HALF) * (end - floor):
                return beside
    if not trials or (closed and len(trials) < 2):
        return None
    alone = find_remainder(problem, before)
    if alone is None or not alone.real:
        return None
    better, _ = bootstrap(left - alone.errors, problem.settings.seed)
    return alone if better > 0.0 and float(alone.errors.mean()) - floor < HALF * (end - floor) else None


def judge(effects: Sequence[Named], remainder: Remainder | None, short: bool) -> Verdict:
    """The verdict that the evidence allows.

    Args:
        effects: what was found.
        remainder: a formula for what has no name, if one holds.
        short: whether a real gap is left open, most of it or, where strange numbers are all that was found, any; or motions never
            fitted contradict what was found.
    """
    if remainder is not None or short:
        return "unnamed"
    if not effects:
        return "none"
    return "cannot_tell" if any(one.confusable_with for one in effects) else "named"
