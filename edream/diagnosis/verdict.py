"""From evidence to a sentence: named, none, cannot tell, or unnamed."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Float

from edream.catalog import load
from edream.core.effect import Effect
from edream.diagnosis.another_way import by_another_way
from edream.diagnosis.backward import backward, refitted_without, still_standing
from edream.diagnosis.candidates import Candidate, placement, standing
from edream.diagnosis.decide import Round
from edream.diagnosis.descent import Fit, polish
from edream.diagnosis.doubts import asked_again, doubtful, others_of
from edream.diagnosis.exchange import exchanged
from edream.diagnosis.finer import with_plain
from edream.diagnosis.forward import forward
from edream.diagnosis.left_out import (
    SEEN,
    SEEN_ORDINARY,
    agreement,
    bootstrap,
    does_better,
    falls_short,
    is_clear,
    is_left,
    is_real,
    proof_errors,
    still_off,
)
from edream.diagnosis.naming import Named, as_written, numbers_of, strange_numbers
from edream.diagnosis.nuisance import fit_nuisance, published, with_shares
from edream.diagnosis.problem import Problem, nuisance_placements
from edream.diagnosis.remainder import Remainder, find_remainder
from edream.diagnosis.steps import for_a_plain_loop, in_a_plain_loop
from edream.diagnosis.suspects import Suspect, find_suspects, most_ordinary, what_stays, with_ordinary_numbers
from edream.diagnosis.trials import Trial, is_another, judged, predicted
from edream.sim.objective import rms
from edream.sim.robot import RobotModel

CLOSED = 0.9  # share of the gap, in root-mean-square error, from which what is left is not worth a formula
AS_GOOD = 1.1  # times the error of names and a formula that a formula alone may have and be preferred

Verdict = Literal["named", "none", "cannot_tell", "unnamed"]


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
        rounds: every forward step with its candidates.
        ladder: label of each step and the error [rad] on each never-fitted motion, (M,).
        remainder: what is left described by a formula, where it has no name.
        contenders: label and fit of each model that these motions cannot tell from another; empty where they can.
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
    rounds: Sequence[Round]
    ladder: Sequence[tuple[str, Float[np.ndarray, "M"]]]
    remainder: Remainder | None
    contenders: Sequence[tuple[str, Fit]]


def diagnose(problem: Problem, done: Callable[[str, int], object] = lambda text, n: None) -> Diagnosis:
    """The whole diagnosis of one problem.

    Args:
        problem: robot, motions and settings.
        done: called with what is under way and how many units of it are finished.
    """
    plain = published(in_a_plain_loop(problem))
    start = Fit(plain, np.zeros(0), np.zeros(0), np.zeros((0, 0)), 1.0)
    ladder = [("published", np.sqrt(proof_errors(problem, start)))]
    problem, before = with_shares(problem, fit_nuisance(problem))
    done("nuisance", 1)
    problem, fit, rounds = forward(problem, before, done)
    problem, fit, rounds = by_another_way(problem, fit, rounds, done)
    before = rounds[0].before
    ladder.append(("calibrated", np.sqrt(proof_errors(problem, before))))
    ladder += [(_label(one.taken), np.sqrt(proof_errors(problem, one.taken.fit))) for one in rounds if one.taken is not None]
    fit, rounds, told = exchanged(problem, fit, rounds, lambda n: done("exchanging names", n))
    ladder += [(label, np.sqrt(proof_errors(problem, one))) for label, one in told]
    taken = [one.taken for one in rounds if one.taken is not None]
    fit, kept = backward(problem, fit, [t.candidate for t in taken], rounds[0].errors)
    fit, kept = still_standing(problem, fit, kept) if len(kept) < len(taken) else (fit, kept)
    fit = with_plain(problem, fit, kept)
    trials, heard = left_alone(problem, fit, rounds, [t for t in taken if t.candidate in kept])
    left = predicted(problem, fit, trials[-1] if len(kept) == len(taken) else None) if trials else rounds[0].errors
    short = falls_short(problem, rounds[0].errors, left) if trials else is_left(problem, left, ladder[1][1] ** 2)
    numbers: list[Named] = []
    suspects: list[Suspect] = []
    # numbers that are strange beside a real gap have made up for it; they are not what is missing
    if not (is_real(problem, left) if trials else short) and may_hide_more(strange_numbers(problem, fit), bool(trials)):
        # a search that ends near enough knows less of valleys, and calls its numbers surer than they are
        fit = most_ordinary(problem, fit if fit.ended else polish(fit))
        if numbers := off_nominal(problem, fit):
            strange = [placement(problem, Candidate(n.name, n.targets)).full_name(q) for n in numbers for q in n.values]
            suspects = find_suspects(problem, fit, strange, lambda n: done("looking behind strange numbers", n))
        if suspects and trials:
            suspects, trials = what_stays(problem, trials, suspects, rounds[0].errors)
            fit, numbers = (fit, numbers) if trials else (before, [])  # strange only beside what went out: no answer alone
    if (numbers or suspects) and not trials:
        home = without_numbers(problem, fit, numbers, suspects)
        found, seen = (suspects[0].fit, SEEN_ORDINARY) if suspects else (fit, SEEN)
        if does_better(problem, found, home, seen):
            before = home
        else:  # ordinary numbers meet motions left out as well, which is no news
            fit, numbers, suspects = home, [], []
    ended = suspects[0].fit if suspects else fit  # what is named is what is written, with the ordinary numbers that it leaves
    trials, heard = asked_again(problem, fit, heard, trials)
    done("asking doubts again", 1)
    effects = [_named(problem, ended, t, heard, trials) for t in trials]
    if suspects or not trials:  # beside a name, a strange number alone is that effect's own form, which no formula has exactly
        effects += with_suspects(problem, numbers, suspects)
    also = [Candidate(one.name, one.targets).label for one in effects[len(trials) :]]
    remainder = rounds[0].formula or unexplained(problem, before, fit, rounds[0].errors, left, trials)
    done("remainder", 1)
    verdict, possible = judge(effects, remainder, short), contenders(fit, trials, effects, heard, suspects)
    if remainder is not None:
        fit = remainder.fit
        effects = [one for one in effects if remainder.beside_names]
        ladder.append(("remainder", np.sqrt(proof_errors(problem, fit))))
    elif also:
        if not trials:
            ladder[1] = ("calibrated", np.sqrt(proof_errors(problem, before)))
        fit = ended
        more = f" and {len(also) - 1} more" if len(also) > 1 else ""
        ladder.append((f"+ {also[0]}{more}", np.sqrt(proof_errors(problem, fit))))
    written, fit = for_a_plain_loop(problem, fit)
    after = np.sqrt(proof_errors(problem, fit))
    ladder[-1] = (ladder[-1][0], after)
    if verdict == "none":
        said = agreement(problem, after**2)
    else:
        said = sentence(verdict, effects, remainder, problem.robot.joints) + still_off(problem, after**2)
    return Diagnosis(
        problem=written,
        searched=problem.robot,
        verdict=verdict,
        sentence=said + on_steps(problem, written),
        effects=tuple(as_written(one, ended, fit) for one in effects),
        before=before,
        after=fit,
        published_rms=rms(ladder[0][1]),
        before_rms=rms(ladder[1][1]),
        after_rms=rms(after),
        rounds=rounds,
        ladder=ladder,
        remainder=remainder,
        contenders=possible if verdict == "cannot_tell" else (),
    )


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


def contenders(
    fit: Fit, trials: Sequence[Trial], effects: Sequence[Named], rounds: Sequence[Round], suspects: Sequence[Suspect]
) -> list[tuple[str, Fit]]:
    """The models that remain possible where the last doubtful effect has rivals: its own and one for each rival."""
    if suspects:
        strange = [("strange numbers", fit)] if trials or all(one.taken is None for one in rounds) else []
        return [*strange, *((s.candidate.label, s.fit) for s in suspects)]
    for trial, named in reversed(list(zip(trials, effects, strict=False))):
        if named.confusable_with:
            own = next(r for r in rounds if r.taken is trial)
            return [(t.candidate.label, t.fit) for t in own.trials if t is trial or t.candidate.label in named.confusable_with]
    return []


def _label(trial: Trial) -> str:
    return f"+ {trial.candidate.label}"


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


def with_suspects(problem: Problem, numbers: list[Named], suspects: Sequence[Suspect]) -> list[Named]:
    """Strange numbers, or the one effect that would make them ordinary: then that, which they may be confused with."""
    if not suspects:
        return numbers
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
            if not trials or short or rest - floor < 0.5 * (end - floor):
                return beside
    if not trials or (closed and len(trials) < 2):
        return None
    alone = find_remainder(problem, before)
    if alone is None or not alone.real:
        return None
    better, _ = bootstrap(left - alone.errors, problem.settings.seed)
    return alone if better > 0.0 and float(alone.errors.mean()) - floor < 0.5 * (end - floor) else None


def judge(effects: Sequence[Named], remainder: Remainder | None, short: bool) -> Verdict:
    """The verdict that the evidence allows.

    Args:
        effects: what was found.
        remainder: a formula for what has no name, if one holds.
        short: whether a real gap is left open, most of it or, where strange numbers are all that was found, any.
    """
    if remainder is not None or short:
        return "unnamed"
    if not effects:
        return "none"
    return "cannot_tell" if any(one.confusable_with for one in effects) else "named"


def sentence(verdict: Verdict, effects: Sequence[Named], remainder: Remainder | None, joints: Sequence[str]) -> str:
    """What was found in words that a roboticist uses; `joints` are all that the robot has. `agreement` says that nothing was."""
    places: dict[str, list[str]] = {}
    for one in effects:
        places.setdefault(one.summary, []).extend(one.targets)
    parts = [summary + _on(targets, joints) for summary, targets in places.items()]
    if verdict == "unnamed":
        nothing = " No formula for it holds on motions left out, either; recordings of more such motions may settle it."
        what = f" It behaves like {remainder.formula} on {remainder.joint}." if remainder else nothing
        beside = f"Your simulator lacks {_and(parts)}, and something else" if parts else "Something real is missing"
        return f"{beside} that no effect in the library explains.{what}"
    if verdict == "cannot_tell":
        doubtful = [one for one in effects if one.confusable_with]
        names = "; ".join(f"{one.name} may be {' or '.join(_short(r, one) for r in one.confusable_with)}" for one in doubtful)
        return f"Your simulator lacks {_and(parts)}, but these motions cannot tell it from others: {names}."
    return f"Your simulator lacks {_and(parts)}."


def on_steps(problem: Problem, written: Problem) -> str:
    """What to say where the published time step is too long, for the robot or for a plain loop; nothing otherwise."""
    published, searched, last = (
        f"{1e3 * float(robot.model.opt.timestep):.3g} ms" for robot in (problem.robot.published, problem.robot, written.robot)
    )
    found = f" Its steps of {published} are too long for this robot; all of this is with steps of {searched}."
    between = f" Commands were recorded between steps of {searched}, so model.xml has steps of {last}."
    return (found if searched != published else "") + (between if last != searched else "")


def _on(targets: Sequence[str], joints: Sequence[str]) -> str:
    if len(targets) > 2 and set(targets) == set(joints):
        return f" on all {len(joints)} joints"
    return f" on {_and(targets)}" if targets else ""


def _short(rival: str, one: Named) -> str:
    """A rival in words: its name alone where it acts where the effect does, and the joints it leaves out where those are fewer."""
    name, _, place = rival.partition("[")
    theirs = place.removesuffix("]").split("+") if place else []
    left = [joint for joint in one.targets if joint not in theirs]
    if not theirs or not set(theirs) <= set(one.targets) or len(left) >= len(theirs):
        return f"{name} on {_and(theirs)}" if theirs else rival
    return f"{name} without {_and(left)}" if left else name


def _and(words: Sequence[str]) -> str:
    return words[0] if len(words) == 1 else ", ".join(words[:-1]) + " and " + words[-1]
