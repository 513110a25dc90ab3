"""Which candidates stand: refits with all nuisance numbers free, judged on motions that the refit did not see."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from edream.catalog import load
from edream.core.effect import Effect
from edream.diagnosis.backward import passes, without
from edream.diagnosis.candidates import Candidate, acted_on, confused_with, placement
from edream.diagnosis.descent import Fit, begin, descend, polish
from edream.diagnosis.ends import SHAPES, begun_again, to_their_ends
from edream.diagnosis.finer import closes_more
from edream.diagnosis.left_out import (
    bootstrap,
    is_brief,
    leaves_no_gap,
)
from edream.diagnosis.nearest import as_much_as, from_nearest, placed_at
from edream.diagnosis.problem import Problem
from edream.diagnosis.remainder import Remainder
from edream.diagnosis.screen import Scored, extend
from edream.diagnosis.side_by_side import side_by_side
from edream.diagnosis.starts import fresh_columns, in_all_strengths_beside_published, of_joints
from edream.diagnosis.suspects import elsewhere
from edream.diagnosis.trials import (
    HOPELESS,
    Trial,
    beside,
    best_of_each,
    gone_on,
    is_usual,
    judged,
    on_few,
    other_answers,
    refitted,
    residual_among,
    rms_among,
)
from edream.sim.least_squares import worth

ALIKE = 0.9  # a rival that closes this share of what the winner closes may be the true one
NEAR, RIVALS = 0.75, 5  # of the best one's gain; so many go on
BEHIND = 0.6  # of it, where the best leaves a gap that can be seen
NARROW = 0.3  # of a quantity's range: an interval that says something
AS_WELL = 0.95  # of the share that an effect closes: its special case closes as much, and needs less to be believed
DISTINCT = 0.5  # of the floor squared, or of the error where that is larger
FEWEST = 3  # motions that a difference may rest on
TWIN_STEPS, FIRST_STEPS = 6, 2  # of a twin, whose joint's numbers have made up for it: a lag beside damping and inertia goes slowly
AS_NEAR = 1.1  # times the best one's error on few motions: a twin beside the best one's numbers that needs no other beginning
FORLORN = 0.2  # of the best one's gain on few motions: a twin that has gained less by its first steps is none
GENERATIONS = 2  # of twins that are heard


@dataclass(frozen=True, eq=False)
class Round:
    """One forward step: the gap before it, every candidate tried, best first, and the one taken, if any.

    `formula` is one that does so much better than every candidate that none was taken.
    """

    before: Fit
    errors: Float[np.ndarray, "M"]
    scored: Sequence[Scored]
    trials: Sequence[Trial]
    taken: Trial | None
    formula: Remainder | None = None


def settled(problem: Problem, fit: Fit, errors: Float[np.ndarray, "M"], trials: Sequence[Trial]) -> list[Trial]:
    """The trials, those near the best gone down to their ends: an effect of more numbers needs more steps to show what it can.

    Where the best leaves a gap that can be seen, those further behind as well, and the first of them to the end of their valleys:
    where one is all but flat (a lag beside damping and inertia) steps have become small long before. The best goes on although it
    is not sure yet: half-way there it may have made one motion worse. So do those that gain in the fit, where none is sure, or
    servos reach their limits: numbers in a false valley may be all that they lack.
    """
    most = max((t.closed for t in trials), default=0.0)
    worth_it = [t for t in trials if t.sure or t.closed >= max(problem.settings.gain, most)]
    doubted = (
        [] if worth_it and not problem.shared else [t for t in trials if t not in worth_it and closes_more(problem, fit, t.fit)]
    )
    gaining = sorted(doubted, key=lambda t: t.fit.rms)
    leads = next(iter(worth_it or gaining), None)
    short = leads is not None and is_brief(leads.fit) and not leaves_no_gap(problem, leads.fit)
    best = [t for t in worth_it if t.closed >= (BEHIND if short else NEAR) * most][:RIVALS] + gaining[:SHAPES]
    near = [t for t in best if is_brief(t.fit) or not passes(problem, t)]
    begun, threads = [replace(t.fit, scale=worth(t.fit.objective, t.fit.residual)) for t in near], problem.settings.threads
    ends = list(side_by_side(lambda one: descend(one, None, 4), begun, threads))
    if problem.shared:
        ends = begun_again(problem, ends, [t.candidate for t in near])
    if short and not any(leaves_no_gap(problem, end) for end in ends):
        ends = to_their_ends(problem, ends)
    again = list(side_by_side(lambda pair: judged(problem, pair[0], errors, pair[1]), list(zip(ends, near, strict=True)), threads))
    better = [max(pair, key=lambda t: (passes(problem, t), t.closed)) for pair in zip(near, again, strict=True)]
    return sorted([*better, *(t for t in trials if t not in near)], key=lambda t: -t.closed)


def restarted(problem: Problem, errors: Float[np.ndarray, "M"], trials: Sequence[Trial]) -> list[Trial]:
    """The trials; where the best leaves a gap, its near rivals also from the nuisance numbers that it found.

    One of them may be what closes the gap, and have been lost where numbers that make up for the whole effect led it; one that is
    known to be confused with the best sooner than others.
    """
    best = next((t for t in trials if passes(problem, t)), None)
    if best is None or leaves_no_gap(problem, best.fit):
        return list(trials)
    bare = without(best.fit, best.candidate)
    twins = {effect.name for effect in confused_with(problem, best.candidate.effect)}
    close = [t for t in trials if t.sure and t.closed >= (NEAR if t.candidate.effect in twins else ALIKE) * best.closed]
    near = other_answers(best, close)[:SHAPES]
    again = list(
        side_by_side(lambda t: judged(problem, beside(problem, bare, t.candidate), errors, t), near, problem.settings.threads)
    )
    better = [max(pair, key=lambda t: (passes(problem, t), t.closed)) for pair in zip(near, again, strict=True)]
    return sorted([*better, *(t for t in trials if t not in near)], key=lambda t: -t.closed)


def simplified(problem: Problem, fit: Fit, errors: Float[np.ndarray, "M"], trials: Sequence[Trial]) -> list[Trial]:
    """The trials, with the special case of the best one begun where that one ended: what its other number was worth shows then."""
    best = next((t for t in trials if passes(problem, t)), None)
    if best is None or (special := load("effects", best.candidate.effect, Effect).special) is None:
        return list(trials)
    plain = Candidate(special[0], best.candidate.targets)
    if any((p.effect.name, tuple(p.targets)) == (plain.effect, plain.targets) for p in fit.objective.simulated.placements):
        return list(trials)  # it is in the model already
    if any(t.candidate == plain and passes(problem, t) and t.closed >= AS_WELL * best.closed for t in trials):
        return list(trials)  # it does as well from where it began
    place = placement(problem, plain)
    extended, _ = extend(fit, [place])
    space, ended = extended.simulated.space, best.fit.space.mapping(best.fit.values)
    found = {name.replace(best.candidate.effect, plain.effect, 1): value for name, value in ended.items()}
    strengths = [p.name for p in place.effect.parameters(problem.robot.model, place.targets) if p.absent is not None]
    if found.keys().isdisjoint(map(place.full_name, strengths)):
        return list(trials)  # its strength has another name: there is no place to begin at
    start = space.to_unit(np.array([found.get(p.name, p.start) for p in space.parameters]))
    end = descend(begin(extended, np.clip(start, 0.0, 1.0)), None, 4)
    trial = judged(problem, end, errors, replace(best, candidate=plain))
    others = [t for t in trials if t.candidate != plain]
    old = [t for t in trials if t.candidate == plain]
    return sorted([*others, max([trial, *old], key=lambda t: t.closed)], key=lambda t: -t.closed)


def simplest(problem: Problem, passing: Sequence[Trial]) -> Trial | None:
    """The best of the candidates that pass, if any; or its special case that does as well, or one that robots have, nearly so."""
    best = passing[0] if passing else None
    if best is None:
        return None
    special = load("effects", best.candidate.effect, Effect).special
    plain = Candidate(special[0], best.candidate.targets) if special else None
    usual = [] if is_usual(problem, best) else [t for t in passing if is_usual(problem, t)]
    plainer = [t for t in passing if t.candidate == plain and t.closed >= AS_WELL * best.closed]
    same = next((t for t in (*plainer, *usual) if t.closed >= ALIKE * best.closed), None)
    return best if same is None or told_apart(problem, same, best) else same


def comes_down_to(problem: Problem, trial: Trial, plain: Candidate) -> bool:
    """Whether a refitted effect is its special case, by an interval that is narrow and holds the value that makes it so.

    Intervals are true at the end of a search: before, one may seem to know what usual numbers make up for.
    """
    special = load("effects", trial.candidate.effect, Effect).special
    if special is None or Candidate(special[0], trial.candidate.targets) != plain:
        return False
    _, quantity, value = special
    place = placement(problem, trial.candidate)
    parameters = place.effect.parameters(problem.robot.model, place.targets)
    box = next(p.high - p.low for p in parameters if p.name == quantity)

    def known(fit: Fit) -> bool:
        low, high = fit.intervals()[place.full_name(quantity)]
        return low <= value <= high and high - low < NARROW * box

    return known(trial.fit) and (trial.fit.ended or known(polish(trial.fit)))


def with_confusable(
    problem: Problem,
    fit: Fit,
    errors: Float[np.ndarray, "M"],
    scored: Sequence[Scored],
    trials: Sequence[Trial],
    done: Callable[[int], object] = lambda n: None,
) -> list[Trial]:
    """The trials, and what the best one and all that cannot be told from it are known to be confused with: no twin goes unheard.

    Nor a twin of theirs: what is heard may be one more that cannot be told from the best.
    """
    found, asked = list(trials), set[tuple[str, tuple[str, ...]]]()
    for _ in range(GENERATIONS):
        best = next((t for t in found if passes(problem, t)), None)
        if best is None:
            break
        near = [t for t in found if t is best or (passes(problem, t) and not told_apart(problem, t, best))]
        own = [effect for one in near if (effect := load("effects", one.candidate.effect, Effect)).place == "body"]
        known = {effect.name: effect for effect in own}  # on another link than the one that it was tried on
        known |= {effect.name: effect for one in near for effect in confused_with(problem, one.candidate.effect)}
        asking = {(one.name, best.candidate.targets if one.place == "body" else ()): one for one in known.values()}
        more = heard(problem, fit, errors, scored, found, best, [asking[one] for one in asking if one not in asked], done)
        if not more:
            break
        asked |= set(asking)
        found = best_of_each([*found, *more])
    return found


def heard(
    problem: Problem,
    fit: Fit,
    errors: Float[np.ndarray, "M"],
    scored: Sequence[Scored],
    trials: Sequence[Trial],
    best: Trial,
    known: Sequence[Effect],
    done: Callable[[int], object],
) -> list[Trial]:
    """Effects that have not been tried where the best trial acts, or came to little there, refitted patiently.

    Each is heard where the best one acts; where it can't act there, at the place that the score test likes best; on links, at the
    outermost one in any case, where a robot carries what it carries, and at those next to the best one's.
    """
    places = [*scored, *placed_at(problem, fit, best.candidate.targets, known)]
    places.sort(key=lambda s: s.candidate.targets != best.candidate.targets)  # the score test's order otherwise
    chosen = {s.candidate.effect: s for s in reversed(places) if s.candidate.effect in [one.name for one in known]}
    others = [s for s in elsewhere(problem, fit, best.candidate) if s.candidate.effect in chosen]
    # by a few steps with stale columns a lag is lost behind a delay
    tried = [t.candidate for t in trials if t.closed >= ALIKE * best.closed or t.candidate.targets != best.candidate.targets]
    twins = list({s.candidate: s for s in (*chosen.values(), *others) if s.candidate not in tried}.values())
    if not twins:
        return []
    few, bare = on_few(problem, fit), without(best.fit, best.candidate)
    found, told = at_numbers_of(few, bare), rms_among(few, best.fit)
    most = 1.0 - (told / few.rms) ** 2
    enough = AS_NEAR * told if leaves_no_gap(problem, best.fit) else 0.0

    def refitted_there(one: Scored) -> Trial | None:
        joints = acted_on(one.candidate)
        # what does the same has the same numbers, and may be far from there otherwise
        ends = [from_nearest(problem, found, one, as_much_as(best.fit, best.candidate), TWIN_STEPS)]
        if ends[0].rms <= enough:
            return judged(problem, gone_on(bare, ends[0], joints), errors, one)
        begun = refitted(problem, few, one, iterations=FIRST_STEPS, joints=joints)
        if joints:  # damping and inertia that have made up for a lag leave it no slope beside them
            ends.append(from_nearest(problem, few, one, in_all_strengths_beside_published, TWIN_STEPS))
        if 1.0 - (begun.rms / few.rms) ** 2 >= FORLORN * most:
            own = fresh_columns(few, begun.objective) | of_joints(begun.objective, joints)
            ends.append(descend(begun, own, TWIN_STEPS - FIRST_STEPS))
        end = min(ends, key=lambda one: one.rms)
        hopeful = 1.0 - (end.rms / few.rms) ** 2 >= HOPELESS * most
        return judged(problem, gone_on(fit, end, joints), errors, one) if hopeful else None

    more = []
    for trial in side_by_side(refitted_there, twins, problem.settings.threads):
        more += [trial] if trial is not None else []
        done(1)
    return more


def at_numbers_of(few: Fit, fit: Fit) -> Fit:
    """A fit on few motions at the numbers of another one of the same model, which was fitted to more."""
    return replace(few, unit=fit.unit, residual=residual_among(few, fit))


def rivals(problem: Problem, trials: Sequence[Trial], winner: Trial) -> list[tuple[Trial, bool]]:
    """The other candidates of a round, and whether motions can tell each from the winner.

    An effect that comes down to the winner is no other answer. One that needs no more numbers and meets the fitted motions as well
    is not told from it: left out, each motion is predicted by a step from where the search stands, beside what is not found yet.
    """
    others = [t for t in trials if t.candidate != winner.candidate and not comes_down_to(problem, t, winner.candidate)]
    return [(one, told_apart(problem, one, winner) and not meets_as_well(one, winner)) for one in others]


def meets_as_well(one: Trial, other: Trial) -> bool:
    """Whether a candidate that surely helps is, with no more numbers, as near the fitted motions as another."""
    return one.sure and len(one.fit.unit) <= len(other.fit.unit) and one.fit.rms <= other.fit.rms


def told_apart(problem: Problem, worse: Trial, better: Trial) -> bool:
    """Whether left-out motions speak for the better of two candidates.

    They do where a paired bootstrap says so and the difference is more than two correct simulators may have between them: over all
    motions, or twice that over the quarter that shows most: a few recordings made to tell the two apart may be among many others.
    """
    apart = worse.errors - better.errors
    low, _ = bootstrap(apart, problem.settings.seed)
    least = DISTINCT * max(problem.floor**2, float(better.errors.mean()))
    clearest = np.sort(apart)[-max(FEWEST, len(apart) // 4) :]
    return low > 0.0 and (float(apart.mean()) > least or float(clearest.mean()) > 2.0 * least)
