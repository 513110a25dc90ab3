"""Which candidates stand: refits with all nuisance numbers free, judged on motions that the refit did not see."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from edream.catalog import load
from edream.core.effect import Effect
from edream.diagnosis.candidates import Candidate, placement
from edream.diagnosis.descent import Fit, begin, descend, polish, stretches
from edream.diagnosis.left_out import bootstrap, far_off, is_brief, left_out_errors
from edream.diagnosis.problem import Problem
from edream.diagnosis.rough import rough_candidates, searched
from edream.diagnosis.screen import Scored, extend, scaled_probe, screen, unexplained_by, with_quantities
from edream.sim.differences import STEP
from edream.sim.least_squares import worth
from edream.sim.objective import Objective, rms
from edream.sim.simulation import Placement

REFITTED, GROUPS, FINISHED = 8, 4, 6
HOPELESS = 0.4  # of the best candidate's gain after two steps: those below are not refitted to the end
SHAPED = 1.5  # floors of error from which a winner is tried in its other shapes
SHAPES = 3  # so many of them
MATERIAL = 0.05  # of the gap at first, in root-mean-square error, that a further effect must close
NEAR, RIVALS = 0.75, 5  # of the best one's gain; so many go on
NARROW = 0.3  # of a quantity's range: an interval that says something
AS_WELL = 0.95  # of the share that an effect closes: its special case closes as much, and needs less to be believed
DISTINCT = 0.5  # of the floor squared, or of the error where that is larger
SERIOUS_SHARE = 0.01
STRONG = 5.0  # probes
HALF = 0.5  # of the gap: a candidate that closes less of a real one may be a stand-in
BOUND = 1e-3  # of the unit box: nearer, a number sits at its bound
REAL_GAP = 1.8  # how many floors of left-out error are a gap worth a name


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


@dataclass(frozen=True, eq=False)
class Round:
    """One forward step: the gap before it, every candidate tried, best first, and the one taken, if any."""

    before: Fit
    errors: Float[np.ndarray, "M"]
    scored: Sequence[Scored]
    trials: Sequence[Trial]
    taken: Trial | None


def forward(problem: Problem, fit: Fit, done: Callable[[str, int], object] = lambda text, n: None) -> tuple[Fit, list[Round]]:
    """Add effects while they pass, the best on left-out motions first.

    Returns:
        The final fit and every round, the last of which took nothing unless the most effects were reached.
    """
    rounds: list[Round] = []
    for _ in range(problem.settings.most):
        errors = left_out_errors(problem, fit)
        first = rounds[0].errors if rounds else errors
        left, whole = (float(np.sqrt(e.mean())) - problem.floor for e in (errors, first))
        if left <= max(0.25 * problem.floor, MATERIAL * whole if rounds else 0.0):
            rounds.append(Round(fit, errors, [], [], None))
            break
        scored = screen(problem, fit, lambda n: done("screening", n))
        trials = try_best(problem, fit, errors, scored, lambda n: done("refitting", n))
        trials = with_rough(problem, fit, errors, trials, lambda n: done("searching", n))
        trials = with_confusable(problem, fit, errors, scored, trials, lambda n: done("refitting", n))
        trials = settled(problem, errors, trials)
        trials = simplified(problem, fit, errors, trials)
        taken = simplest([t for t in trials if passes(problem, t) and matters(problem, first, errors, t)])
        rounds.append(Round(fit, errors, scored, trials, taken))
        if taken is None:
            break
        fit = polish(arrived(problem, fit, taken))
    return fit, rounds


def matters(problem: Problem, first: Float[np.ndarray, "M"], errors: Float[np.ndarray, "M"], trial: Trial) -> bool:
    """Whether a candidate's gain is worth a name beside the gap that was there at first; always so for the first one.

    What comes after a large effect and gains little more is mostly that effect's own form, which no formula has exactly.
    """
    gap = float(np.sqrt(first.mean())) - problem.floor
    return first is errors or float(np.sqrt(errors.mean()) - np.sqrt(trial.errors.mean())) >= MATERIAL * gap


def settled(problem: Problem, errors: Float[np.ndarray, "M"], trials: Sequence[Trial]) -> list[Trial]:
    """The trials, those near the best gone down to their ends: an effect of more numbers needs more steps to show what it can."""
    best = [t for t in trials if t.sure and t.closed >= NEAR * max(t.closed for t in trials)][:RIVALS]
    near = [t for t in best if is_brief(t.fit) or not passes(problem, t)]
    ends = [descend(replace(t.fit, scale=worth(t.fit.objective, t.fit.residual)), None, 4) for t in near]
    again = [judged(problem, end, errors, t) for end, t in zip(ends, near, strict=True)]
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
    extended, _ = extend(fit, [placement(problem, plain)])
    space, ended = extended.simulated.space, best.fit.space.mapping(best.fit.values)
    found = {name.replace(best.candidate.effect, plain.effect, 1): value for name, value in ended.items()}
    start = space.to_unit(np.array([found.get(p.name, p.start) for p in space.parameters]))
    end = descend(begin(extended, np.clip(start, 0.0, 1.0)), None, 4)
    trial = judged(problem, end, errors, replace(best, candidate=plain))
    others = [t for t in trials if t.candidate != plain]
    old = [t for t in trials if t.candidate == plain]
    return sorted([*others, max([trial, *old], key=lambda t: t.closed)], key=lambda t: -t.closed)


def arrived(problem: Problem, before: Fit, taken: Trial) -> Fit:
    """The winner's fit gone down to the end; where that leaves a gap, from its other shapes as well.

    Those begin at the nuisance numbers from before it, which have not yet made up for a wrong shape.
    """
    fit = descend(replace(taken.fit, scale=worth(taken.fit.objective, taken.fit.residual)), None, 4)
    place = placement(problem, taken.candidate)
    extended, absent = extend(before, [place])
    sets = [with_quantities(extended, absent, [place], [shape]) for shape in strong_probes(problem, place)]
    if fit.rms <= SHAPED * problem.floor or len(sets) < 2:
        return fit
    residuals = extended.residuals(np.array(sets))
    promising = np.argsort([rms(r) for r in residuals], kind="stable")[:SHAPES]
    own, space = fresh_columns(before, extended), extended.simulated.space
    others = [descend(begin(extended, np.clip(space.to_unit(sets[number]), 0.0, 1.0)), own, 3) for number in promising]
    again = descend(min(others, key=lambda other: other.rms), None, 4)
    return again if again.rms < fit.rms else fit


def simplest(passing: Sequence[Trial]) -> Trial | None:
    """The best of the candidates that pass, or the special case of it that does as well; None where none passes."""
    if not passing or (special := load("effects", passing[0].candidate.effect, Effect).special) is None:
        return passing[0] if passing else None
    plain = Candidate(special[0], passing[0].candidate.targets)
    return next((t for t in passing if t.candidate == plain and t.closed >= AS_WELL * passing[0].closed), passing[0])


def comes_down_to(problem: Problem, trial: Trial) -> Candidate | None:
    """The simpler effect that a refitted one is, where its interval is narrow and holds the value that makes it so."""
    special = load("effects", trial.candidate.effect, Effect).special
    if special is None:
        return None
    effect, quantity, value = special
    place = placement(problem, trial.candidate)
    parameters = place.effect.parameters(problem.robot.model, place.targets)
    box = next(p.high - p.low for p in parameters if p.name == quantity)
    low, high = trial.fit.intervals()[place.full_name(quantity)]
    known = low <= value <= high and high - low < NARROW * box
    return Candidate(effect, trial.candidate.targets) if known else None


def try_best(
    problem: Problem,
    fit: Fit,
    errors: Float[np.ndarray, "M"],
    scored: Sequence[Scored],
    done: Callable[[int], object] = lambda n: None,
) -> list[Trial]:
    """Refit the candidates with the largest shares; best on left-out motions first."""
    if far_off(problem, fit):
        return try_boldly(problem, fit, errors, scored, done)
    serious = [s for s in scored if s.share >= SERIOUS_SHARE]
    # one set of numbers for a hardware group rests on all its joints, which the test of single joints undervalues
    groups = [s for s in serious if len(s.candidate.targets) > 1][:GROUPS]
    begun = []
    for one in [*serious[:REFITTED], *(s for s in groups if s not in serious[:REFITTED])]:
        begun.append((refitted(problem, fit, one, iterations=2), one))
        done(1)
    begun.sort(key=lambda pair: pair[0].rms)
    gained = [1.0 - (near.rms / fit.rms) ** 2 for near, _ in begun]
    trials = []
    for (near, one), gain in zip(begun, gained, strict=True):
        if gain >= HOPELESS * gained[0] and len(trials) < FINISHED:
            trials.append(judged(problem, descend(near, fresh_columns(fit, near.objective), iterations=4), errors, one))
    return sorted(trials, key=lambda t: -t.closed)


def try_boldly(
    problem: Problem, fit: Fit, errors: Float[np.ndarray, "M"], scored: Sequence[Scored], done: Callable[[int], object]
) -> list[Trial]:
    """Every effect at its best place, from the best of several starts, on short stretches first; the best ones all the way."""
    brief = begin(replace(fit.objective, windows=stretches(fit), simulations=0), fit.unit)
    rough = []
    for one in {s.candidate.effect: s for s in reversed(scored)}.values():
        place = placement(problem, one.candidate)
        extended, absent = extend(brief, [place])
        starts = bold_starts(problem, place, one, extended, absent)
        best = starts[int(np.argmin([rms(r) for r in extended.residuals(np.array(starts))]))]
        near = descend(with_column(brief, extended, best), fresh_columns(brief, extended), 3)
        rough.append((near, extend(fit, [place])[0], one))
        done(1)
    rough.sort(key=lambda found: found[0].rms)
    trials = []
    for begun, extended, one in rough[:REFITTED]:
        near = descend(begun, None, iterations=6)
        trials.append(judged(problem, descend(begin(extended, near.unit), None, iterations=4), errors, one))
        done(1)
    return sorted(trials, key=lambda t: -t.closed)


def bold_starts(
    problem: Problem, place: Placement, scored: Scored, extended: Objective, absent: Float[np.ndarray, "P"]
) -> list[Float[np.ndarray, "P"]]:
    """Parameter sets: where the score test says, and strong versions; each also with little of the friction it may replace."""
    quantities = [scored.start, *strong_probes(problem, place)[:4]]
    starts = [with_quantities(extended, absent, [place], [one]) for one in quantities]
    friction = np.array([name.startswith("coulomb.") for name in extended.simulated.space.names])
    return [*starts, *(np.where(friction, 0.2 * start, start) for start in starts if friction.any())]


def with_rough(
    problem: Problem,
    fit: Fit,
    errors: Float[np.ndarray, "M"],
    trials: Sequence[Trial],
    done: Callable[[int], object] = lambda n: None,
) -> list[Trial]:
    """The trials; where none that passes closes as much as half of a real gap, also the effects that no descent finds."""
    best = next((t for t in trials if passes(problem, t)), None)
    left = errors if best is None else best.errors
    if float(np.sqrt(left.mean())) < REAL_GAP * problem.floor or (best is not None and best.closed >= HALF):
        return list(trials)
    more = []
    for candidate in rough_candidates(problem, fit):
        more.append(judged(problem, searched(problem, fit, candidate), errors, Scored(candidate, {}, 0.0)))
        done(1)
    others = [t for t in trials if t.candidate not in [m.candidate for m in more]]
    return sorted([*others, *more], key=lambda t: -t.closed)


def with_confusable(
    problem: Problem,
    fit: Fit,
    errors: Float[np.ndarray, "M"],
    scored: Sequence[Scored],
    trials: Sequence[Trial],
    done: Callable[[int], object] = lambda n: None,
) -> list[Trial]:
    """The trials and those of the effects that the best one is known to be confused with, so that no twin goes unheard."""
    best = next((t for t in trials if passes(problem, t)), None)
    if best is None:
        return list(trials)
    own = load("effects", best.candidate.effect, Effect)
    every = {s.candidate.effect: load("effects", s.candidate.effect, Effect) for s in scored}
    known = {name for name, effect in every.items() if name in own.confusable or own.name in effect.confusable}
    tried = {t.candidate.effect for t in trials}
    twins = {s.candidate.effect: s for s in reversed(scored) if s.candidate.effect in known and s.candidate.effect not in tried}
    more = []
    for one in twins.values():
        more.append(refit(problem, fit, errors, one))
        done(1)
    return sorted([*trials, *more], key=lambda t: -t.closed)


def refit(problem: Problem, fit: Fit, errors: Float[np.ndarray, "M"], scored: Scored) -> Trial:
    """One candidate, from where the score test puts it, with all nuisance numbers free, judged on motions left out."""
    return judged(problem, refitted(problem, fit, scored, iterations=6), errors, scored)


def refitted(problem: Problem, fit: Fit, scored: Scored, iterations: int) -> Fit:
    """The model with one candidate, some steps from where the score test puts it, in whichever of its shapes promises most."""
    place = placement(problem, scored.candidate)
    extended, absent = extend(fit, [place])
    starts = [with_quantities(extended, absent, [place], [one]) for one in shapes(problem, place, scored.start)]
    best = int(np.argmin(unexplained_by(fit)(extended.residuals(np.array(starts))))) if len(starts) > 1 else 0
    return descend(with_column(fit, extended, starts[best]), fresh_columns(fit, extended), iterations)


def shapes(problem: Problem, place: Placement, start: Mapping[str, float]) -> list[dict[str, float]]:
    """A candidate's quantities as they are, and with the same strength in the shape of each of its probes (a speed, a place)."""
    parameters = place.effect.parameters(problem.robot.model, place.targets)
    form = [p.name for p in parameters if p.absent is None]
    others = [{**start, **{name: probe[name] for name in form if name in probe}} for probe in probes_of(problem, place)]
    return [one for i, one in enumerate([dict(start), *others]) if one not in [dict(start), *others][:i]]


def probes_of(problem: Problem, place: Placement) -> Sequence[Mapping[str, float]]:
    return place.effect.probes(problem.robot.model, place.targets)


def strong_probes(problem: Problem, place: Placement) -> list[dict[str, float]]:
    """The probes made strong, inside the box; those that end in the same corner of it count once."""
    scaled = [scaled_probe(place, problem, probe, STRONG) for probe in probes_of(problem, place)]
    return [one for i, one in enumerate(scaled) if one is not None and one not in scaled[:i]]


def judged(problem: Problem, fit: Fit, errors: Float[np.ndarray, "M"], scored: Scored | Trial) -> Trial:
    """A refitted candidate on motions left out, against `errors` without it."""
    left = left_out_errors(problem, fit)
    gain = errors - left
    gap = max(float(errors.mean()) - problem.floor**2, 1e-18)
    low, _ = bootstrap(gain, problem.settings.seed)
    return Trial(scored.candidate, scored.share, fit, left, float(gain.mean()) / gap, low > 0.0)


def fresh_columns(fit: Fit, extended: Objective) -> np.ndarray:
    return np.arange(len(extended.simulated.space)) >= len(fit.unit)


def with_column(fit: Fit, extended: Objective, start: Float[np.ndarray, "P"]) -> Fit:
    """The fit at a larger model's starting point: nuisance columns are kept, the candidate's are differenced."""
    space = extended.simulated.space
    unit = np.clip(space.to_unit(start), 0.0, 1.0)
    new = np.flatnonzero(fresh_columns(fit, extended))
    steps = np.where(unit + STEP <= 1.0, STEP, -STEP)
    residuals = extended.residuals(space.from_unit(np.vstack([unit, unit + np.diag(steps)[new]])))
    columns = ((residuals[1:] - residuals[0]) / steps[new, None]).T
    return Fit(extended, unit, residuals[0], np.hstack([fit.jacobian, columns]), worth(extended, residuals[0]))


def passes(problem: Problem, trial: Trial) -> bool:
    """Whether a refitted candidate may be named: large enough, sure, its own numbers away from nothing and from their bounds."""
    return trial.closed >= problem.settings.gain and trial.sure and stands(problem, trial.candidate, trial.fit)


def stands(problem: Problem, candidate: Candidate, fit: Fit) -> bool:
    """Whether some parameter of the effect has an interval that excludes its absence, and none of those sits at a bound."""
    place = placement(problem, candidate)
    intervals, unit = fit.intervals(), dict(zip(fit.space.names, fit.unit, strict=True))
    away = []
    for parameter in place.parameters(problem.robot.model):
        if parameter.absent is None:
            continue
        low, high = intervals[parameter.name]
        excludes = not low <= parameter.absent <= high
        inside = BOUND <= unit[parameter.name] <= 1.0 - BOUND  # in the box that is searched, logarithmic for a limit
        away.append(excludes and inside)
    return any(away)


def backward(problem: Problem, fit: Fit, named: Sequence[Candidate]) -> tuple[Fit, list[Candidate]]:
    """Take out effects that later ones explain: those without which left-out motions are predicted as well."""
    kept = list(named)
    for candidate in list(named)[:-1] if len(named) > 1 else []:
        errors = left_out_errors(problem, fit)
        smaller = without(fit, candidate)
        refitted = descend(smaller, None, 3)
        gain = left_out_errors(problem, refitted) - errors
        low, _ = bootstrap(gain, problem.settings.seed)
        gap = max(float((errors + gain).mean()) - problem.floor**2, 1e-18)
        if low <= 0.0 or float(gain.mean()) / gap < problem.settings.gain:
            fit, kept = refitted, [c for c in kept if c != candidate]
    return fit, kept


def without(fit: Fit, candidate: Candidate) -> Fit:
    """The fit's model without one effect, from the same values of all others."""
    simulated = fit.objective.simulated
    gone = next(p for p in simulated.placements if (p.effect.name, p.targets) == (candidate.effect, candidate.targets))
    dropped = {p.name for p in gone.parameters(simulated.robot.model)}
    keep = np.array([name not in dropped for name in fit.space.names])
    smaller = replace(fit.objective, simulated=simulated.with_placements([p for p in simulated.placements if p is not gone]))
    residual = smaller.residuals(smaller.simulated.space.from_unit(fit.unit[keep]))[0]
    return Fit(smaller, fit.unit[keep], residual, fit.jacobian[:, keep], worth(smaller, residual))


def rivals(problem: Problem, trials: Sequence[Trial], winner: Trial) -> list[tuple[Trial, bool]]:
    """The other candidates of a round, and whether left-out motions can tell each from the winner.

    They can where a paired bootstrap says so and the difference is more than two correct simulators may have between them. An
    effect that comes down to the winner is no other answer.
    """
    out = []
    least = DISTINCT * max(problem.floor**2, float(winner.errors.mean()))
    for trial in trials:
        if trial.candidate != winner.candidate and comes_down_to(problem, trial) != winner.candidate:
            worse = trial.errors - winner.errors
            low, _ = bootstrap(worse, problem.settings.seed)
            out.append((trial, low > 0.0 and float(worse.mean()) > least))
    return out
