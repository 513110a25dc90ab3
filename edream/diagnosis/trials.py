"""Candidates refitted: from where the score test puts each, with all nuisance numbers free, judged on motions left out."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from edream.diagnosis.candidates import Candidate, acted_on, library, placement, probes_of
from edream.diagnosis.descent import STRETCH, Fit, begin, descend, stretches
from edream.diagnosis.few import ENOUGH, thinned
from edream.diagnosis.left_out import (
    HALF,
    bootstrap,
    far_off,
    gap_above_floor,
    is_real,
    is_small,
    leaves_no_gap,
    led_astray,
    left_out_errors,
    worst_joint,
)
from edream.diagnosis.nearest import ARRIVING, begun_in_all_strengths, by_nearness, descend_from, placed_at
from edream.diagnosis.problem import Problem
from edream.diagnosis.screen import (
    Scored,
    extend,
    lightened,
    unexplained_by,
    with_quantities,
)
from edream.diagnosis.side_by_side import side_by_side
from edream.diagnosis.starts import (
    beside_published,
    bold_starts,
    fresh_columns,
    in_all_strengths,
    in_all_strengths_beside_published,
    of_joints,
    shapes,
    with_column,
)
from edream.diagnosis.steps import with_long_steps
from edream.diagnosis.valleys import groups_off
from edream.sim.objective import rms

REFITTED, GROUPS, FINISHED = 8, 4, 4
LIKELIEST = 3  # by the score test: they are refitted on whole motions even where candidates are tried boldly
HOPELESS = 0.4  # of the best candidate's gain after two steps: those below are not refitted to the end
SERIOUS_SHARE = 0.01
NEARLY = 0.9  # of the squared gap above the floor: what is left asks for no search of every effect
ALL_BUT = 0.99  # of it, nine tenths of the error: what is left, however real, is rather what another effect does
FARTHER = 2  # of these, begun beside published numbers, go to their ends beyond the first ones of all
UNLIKELY = 0.3  # of the largest share by the score test: those below wait, and are not refitted where another closes nearly all
TOLD = 0.02  # of the squared error: what a candidate's search gains less by does not change what it is worth beside others


@dataclass(frozen=True, eq=False)
class Trial:
    """A candidate refitted.

    Attributes:
        candidate: effect and place.
        share: what the score test gave it.
        fit: the model with it, all nuisance numbers free.
        errors: mean squared error [rad^2] of each fitted motion while it was left out, (M,).
        closed: share of the gap above the floor that it closes on left-out motions.
        sure: whether a paired bootstrap over motions puts the improvement above zero.
    """

    candidate: Candidate
    share: float
    fit: Fit
    errors: Float[np.ndarray, "M"]
    closed: float
    sure: bool


def try_best(
    problem: Problem,
    fit: Fit,
    errors: Float[np.ndarray, "M"],
    scored: Sequence[Scored],
    done: Callable[[int], object] = lambda n: None,
) -> list[Trial]:
    """Refit the candidates with the largest shares; best on left-out motions first."""
    if far_off(problem, fit) and is_small(fit):
        places = [*{s.candidate.effect: s for s in reversed(scored)}.values(), *overlooked(problem, fit, scored)]
        likely = {s.candidate: s for s in (*scored[:LIKELIEST], *nearer_beside_published(problem, thinned(fit, ENOUGH), places))}
        plain = list(side_by_side(lambda one: refit(problem, fit, errors, one), list(likely.values()), problem.settings.threads))
        if not any(t.sure and (leaves_no_gap(problem, t.fit) or leaves_little(problem, t)) for t in plain):
            # short stretches forget what was before them (friction that is bent, an integral): both searches count
            bold = try_boldly(problem, fit, errors, places, done)
            plain = {t.candidate: t for t in sorted([*plain, *bold], key=lambda t: t.closed)}.values()
        return sorted(plain, key=lambda t: -t.closed)
    serious = [s for s in scored if s.share >= SERIOUS_SHARE]
    # one set of numbers for a hardware group rests on all its joints, which the test of single joints undervalues
    groups = [s for s in serious if len(s.candidate.targets) > 1][:GROUPS]
    few, threads = on_few(problem, fit), problem.settings.threads
    tried = [*serious[:REFITTED], *(s for s in groups if s not in serious[:REFITTED])]
    likely = [s for s in tried if s.share >= UNLIKELY * scored[0].share]
    begun: list[tuple[Fit, Scored]] = []
    for some in (likely, [s for s in tried if s not in likely]):
        if begun and nearly_closed(problem, few, min(near.rms for near, _ in begun)):
            break
        for near, one in zip(side_by_side(lambda one: refitted(problem, few, one, iterations=2), some, threads), some, strict=True):
            begun.append((near, one))
            done(1)
    off = groups_off(problem, fit)
    apart = begun_in_all_strengths(problem, few, off, in_all_strengths_beside_published)
    begun = sorted([*begun, *apart, *begun_in_all_strengths(problem, few, off, in_all_strengths)], key=lambda pair: pair[0].rms)
    begun = [pair for i, pair in enumerate(begun) if pair[1].candidate not in [one.candidate for _, one in begun[:i]]]
    gained = [1.0 - (near.rms / few.rms) ** 2 for near, _ in begun]
    able = [pair for pair, gain in zip(begun, gained, strict=True) if gain >= HOPELESS * gained[0]]
    # those that began beside published numbers have further to go, and are no worse for that
    hopeful = able[:FINISHED] + [pair for pair in able[FINISHED:] if pair in apart][:FARTHER]
    # what the score test says most for may only begin slowly: a payload has four numbers, beside some that have made up for it
    likeliest = [one.candidate for one in scored[:1]]
    hopeful += [pair for pair in begun if pair[1].candidate in likeliest and pair not in hopeful]
    astray = bool(off) or led_astray(problem, fit)
    return sorted(finished(problem, fit, errors, hopeful, astray), key=lambda t: -t.closed)


def finished(
    problem: Problem, fit: Fit, errors: Float[np.ndarray, "M"], begun: Sequence[tuple[Fit, Scored]], renewed: bool = True
) -> Iterable[Trial]:
    """Candidates that were begun, gone on with beside `fit` and judged; `renewed` differences their joints' usual numbers, too."""

    def one_by_one(pair: tuple[Fit, Scored]) -> Trial:
        near, one = pair
        return judged(problem, gone_on(fit, near, acted_on(one.candidate) if renewed else frozenset()), errors, one)

    return side_by_side(one_by_one, begun, problem.settings.threads)


def nearly_closed(problem: Problem, before: Fit, left: float) -> bool:
    """Whether an error [rad] is nearly none of a fit's gap above the floor."""
    return before.rms**2 - left**2 >= NEARLY * (before.rms**2 - problem.floor**2)


def leaves_little(problem: Problem, trial: Trial) -> bool:
    """Whether a refitted candidate closes all but little of the gap, or nearly all and leaves none that asks for a name."""
    return trial.closed >= ALL_BUT or (trial.closed >= NEARLY and not is_real(problem, trial.errors))


def on_few(problem: Problem, fit: Fit) -> Fit:
    """The fit on as much motion as shows which candidates are worth a search: 40 s; 20 s in long steps for what costs more."""
    return thinned(fit, 2.0 * ENOUGH) if is_small(fit) else lightened(problem, fit)


def residual_among(few: Fit, fit: Fit) -> Float[np.ndarray, "R"]:
    """The residual [rad] of another model, as it was fitted, on the motions and in the steps of `few`."""
    simulated = few.objective.simulated.with_placements(fit.objective.simulated.placements)
    return replace(few.objective, simulated=simulated, simulations=0).residuals(fit.values)[0]


def rms_among(few: Fit, fit: Fit) -> float:
    """The error [rad] of another model, as it was fitted, on the motions and in the steps of `few`."""
    return rms(residual_among(few, fit))


def gone_on(fit: Fit, near: Fit, joints: frozenset[str] = frozenset()) -> Fit:
    """A candidate's first steps beside `fit` taken on, on all of its motions; they may have been taken on a few, in longer steps.

    Where usual numbers have gone with those few and are far off in all of them, those of the fit are taken again. The usual numbers
    of `joints` are differenced with the candidate's own.
    """
    own = fresh_columns(fit, near.objective) | of_joints(near.objective, joints)
    if len(near.residual) < len(fit.residual) or near.objective.offset is not None:
        simulated = fit.objective.simulated.with_placements(near.objective.simulated.placements)
        whole = replace(fit.objective, simulated=simulated, simulations=0)
        starts = np.array([near.values, np.append(fit.values, near.values[len(fit.values) :])])
        near = with_column(fit, whole, starts[np.argmin([rms(r) for r in whole.residuals(starts)])], own)
    return descend(near, own, iterations=4, tolerance=TOLD)


def try_boldly(
    problem: Problem, fit: Fit, errors: Float[np.ndarray, "M"], places: Sequence[Scored], done: Callable[[int], object]
) -> list[Trial]:
    """Candidates, each from the best of several starts, on short stretches first; the best ones all the way."""
    small = is_small(fit)
    brief = on_stretches(problem, thinned(fit, 2.0 * ENOUGH if small else ENOUGH))

    def roughly(one: Scored) -> tuple[Fit, Scored]:
        place = placement(problem, one.candidate)
        extended, absent = extend(brief, [place])
        starts, plain = bold_starts(problem, place, one, extended, absent), beside_published(problem, place, extended, absent)
        left = [rms(r) for r in extended.residuals(np.array([*starts, *plain]))]
        near = int(np.argmin(left))
        if near < len(starts):
            return descend(with_column(brief, extended, starts[near]), fresh_columns(brief, extended), 3), one
        return descend_from(brief, extended, plain[near - len(starts)], one.candidate, 3), one

    def wholly(found: tuple[Fit, Scored]) -> Trial:
        begun, one = found
        near = descend(begun, None, iterations=6)
        extended, _ = extend(fit, [placement(problem, one.candidate)])
        start = np.clip(extended.simulated.space.to_unit(near.values), 0.0, 1.0)
        return judged(problem, descend(begin(extended, start), None, iterations=4), errors, one)

    rough = []
    for found in side_by_side(roughly, places, problem.settings.threads):
        rough.append(found)
        done(1)
    rough.sort(key=lambda found: found[0].rms)
    gained = [1.0 - (near.rms / brief.rms) ** 2 for near, _ in rough[: REFITTED if small else LIKELIEST]]
    count = next((n for n, gain in enumerate(gained) if gain < HOPELESS * gained[0]), len(gained))
    trials = []
    for trial in side_by_side(wholly, rough[: max(count, GROUPS if small else 1)], problem.settings.threads):
        trials.append(trial)
        done(1)
    return sorted(trials, key=lambda t: -t.closed)


def on_stretches(problem: Problem, fit: Fit, seconds: float = STRETCH) -> Fit:
    """The fit on its motions cut into short stretches, whose errors have few false valleys; in the published steps."""
    objective = replace(fit.objective, windows=stretches(fit, seconds), simulations=0)
    there = replace(fit, objective=objective, residual=objective.residuals(fit.values)[0])
    return begin(with_long_steps(problem, there).objective, fit.unit)


def nearer_beside_published(problem: Problem, fit: Fit, places: Sequence[Scored]) -> list[Scored]:
    """The candidates that are nearer to the motions than the fit is, small beside the published numbers; nearest first."""
    return [one for error, _, one in by_nearness(problem, fit, places, beside_published) if error < fit.rms][:LIKELIEST]


def with_bold(
    problem: Problem,
    fit: Fit,
    errors: Float[np.ndarray, "M"],
    trials: Sequence[Trial],
    done: Callable[[int], object] = lambda n: None,
) -> list[Trial]:
    """The trials; where none closes half of a gap from far away, also every effect on the joint that is off most."""
    if is_small(fit) or not far_off(problem, fit) or any(t.sure and t.closed >= HALF for t in trials):
        return list(trials)
    more = try_boldly(problem, fit, errors, overlooked(problem, fit, []), done)
    return best_of_each([*trials, *more])


def best_of_each(trials: Sequence[Trial]) -> list[Trial]:
    """The best trial of every candidate, best first."""
    best = {t.candidate: t for t in sorted(trials, key=lambda t: t.closed)}
    return sorted(best.values(), key=lambda t: -t.closed)


def overlooked(problem: Problem, fit: Fit, scored: Sequence[Scored]) -> list[Scored]:
    """The effects that are not in `scored`, on the joint that is off most: fitted numbers that are far from true may hide them."""
    known, there = {s.candidate.effect for s in scored}, (worst_joint(problem, fit),)
    return placed_at(problem, fit, there, [effect for effect in library(problem) if effect.name not in known])


def refit(problem: Problem, fit: Fit, errors: Float[np.ndarray, "M"], scored: Scored) -> Trial:
    """One candidate, from where the score test puts it, with all nuisance numbers free, judged on motions left out."""
    return judged(problem, refitted(problem, fit, scored, iterations=6), errors, scored)


def refitted(problem: Problem, fit: Fit, scored: Scored, iterations: int, joints: frozenset[str] = frozenset()) -> Fit:
    """The model with one candidate, some steps from where the score test puts it, in whichever of its shapes promises most.

    From far off it begins beside the published numbers, where that is nearer than beside those that were fitted without it; where
    servos reach their limits, from both, since no descent leaves the false valley that those may stand in. What
    the usual numbers do is taken from the fit without it, and followed by Broyden's update, but for those of `joints`, which are
    differenced with it: beside a lag, inertia and damping do something else.
    """
    place = placement(problem, scored.candidate)
    extended, absent = extend(fit, [place])
    starts = [with_quantities(extended, absent, [place], [one]) for one in shapes(problem, place, scored.start)]
    best = int(np.argmin(unexplained_by(fit)(extended.residuals(np.array(starts))))) if len(starts) > 1 else 0
    apart: list[Fit] = []
    if far_off(problem, fit):
        plain = beside_published(problem, place, extended, absent)
        away = [rms(r) for r in extended.residuals(np.array([starts[best], *plain]))]
        nearest, nearer = plain[int(np.argmin(away[1:]))], min(away) < away[0]
        if nearer or problem.shared:
            most = max(iterations, ARRIVING) if problem.shared else iterations
            apart = [descend_from(fit, extended, nearest, scored.candidate, most)]
        if nearer:
            return apart[0]
    fresh = fresh_columns(fit, extended) | of_joints(extended, joints)
    beside_fitted = descend(with_column(fit, extended, starts[best], fresh), fresh, iterations)
    return min([beside_fitted, *apart], key=lambda one: one.rms)


def beside(problem: Problem, bare: Fit, candidate: Candidate) -> Fit:
    """A candidate in the best of its shapes beside some nuisance numbers, and both together gone down from there."""
    place = placement(problem, candidate)
    extended, absent = extend(bare, [place])
    sets = [with_quantities(extended, absent, [place], [shape]) for shape in probes_of(problem, place)]
    start = sets[int(np.argmin([rms(r) for r in extended.residuals(np.array(sets))]))]
    near = descend(with_column(bare, extended, start), fresh_columns(bare, extended), 3)
    return descend(near, None, 6)


def judged(problem: Problem, fit: Fit, errors: Float[np.ndarray, "M"], scored: Scored | Trial) -> Trial:
    """A refitted candidate on motions left out, against `errors` without it."""
    left = left_out_errors(problem, fit)
    gain = errors - left
    low, _ = bootstrap(gain, problem.settings.seed)
    closed = float(gain.mean()) / gap_above_floor(problem, errors)
    return Trial(scored.candidate, scored.share, fit, left, closed, low > 0.0)


def predicted(problem: Problem, fit: Fit, taken: Trial | None) -> Float[np.ndarray, "M"]:
    """Errors on motions left out [rad^2], (M,), of a model whose last effect was taken: at the end of its search, or before it.

    The smaller count. A model known to predict so well has not become worse because a step at the end leads one fold astray, and
    what mends that alone is no effect.
    """
    errors = left_out_errors(problem, fit)
    return errors if taken is None or errors.mean() <= taken.errors.mean() else taken.errors


def is_another(one: Trial, other: Trial) -> bool:
    """Whether two candidates are different answers: another effect, or the same on joints that do not overlap."""
    mine, others = one.candidate, other.candidate
    return mine != others and (mine.effect != others.effect or not set(mine.targets) & set(others.targets))


def other_answers(best: Trial, trials: Sequence[Trial]) -> list[Trial]:
    """The trials that are other answers than the best and than each other, the first of each."""
    found = [best]
    for trial in trials:
        if all(is_another(trial, one) for one in found):
            found.append(trial)
    return found[1:]


def is_usual(problem: Problem, trial: Trial) -> bool:
    """Whether robots have the effect as it was fitted (see `Effect.is_usual`)."""
    place, found = placement(problem, trial.candidate), trial.fit.space.mapping(trial.fit.values)
    names = [p.name for p in place.effect.parameters(problem.robot.model, place.targets)]
    return place.effect.is_usual({name: found[place.full_name(name)] for name in names})
