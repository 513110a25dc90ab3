"""Effects that hide in ordinary numbers: a payload looks like a weaker gain and more inertia, and leaves no gap behind."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from jaxtyping import Float

from edream.catalog import load
from edream.core.effect import Effect, joint_index
from edream.core.parameters import targets_in
from edream.diagnosis.backward import backward
from edream.diagnosis.candidates import Candidate, acted_on, carried_by, confused_with, library, next_to, on_links, placement
from edream.diagnosis.descent import Fit, begin, cost, descend, polish
from edream.diagnosis.left_out import left_out_errors
from edream.diagnosis.nearest import by_nearness, descend_from, placed_at
from edream.diagnosis.problem import Problem, nuisance_placements
from edream.diagnosis.screen import Scored, extend, screen
from edream.diagnosis.side_by_side import side_by_side
from edream.diagnosis.starts import as_published, in_all_strengths
from edream.diagnosis.trials import Trial, is_usual, judged, refit
from edream.sim.objective import Objective
from edream.sim.simulation import Placement, SimulatedRobot

EVIDENCE = 4.0  # by how much the cost (-2 log posterior) must fall
HOMEWARD = 0.5  # share of the strangeness that a suspect must explain
REFITTED = 10
NEAREST = 3  # of what is put in the place of strange numbers
PROMISING, PATIENTLY = 0.5, 8  # of the largest relief, from which suspects are fitted on, for so many steps
AS_GOOD = 1.03  # times the error without it
TIGHTER = (0.5, 0.3)  # times the usual width of what is believed
AS_WELL_MET = 1.003  # times the error of the fit that is free to leave the published numbers
FLOOR_KNOWN = 1.02  # times the floor: an error below is what a true simulator may leave
ORDINARY = (0.68, 1.35)  # times a published number: what may be expected, 30 % off is usual
SERVO = ("servo_gain.kp", "viscous.damping", "viscous.inside")
LITTLE = 0.1  # of a joint's damping, the servo's included: so much of it may be the joint's own where none is published
BENT = 0.25  # of the error that two true simulators may have between them: so much of it numbers may have taken up


@dataclass(frozen=True, eq=False)
class Suspect:
    """An effect with which the nuisance numbers are ordinary and the recordings are met as well.

    Attributes:
        candidate: effect and place.
        fit: the model with it.
        relief: by how much the cost falls.
    """

    candidate: Candidate
    fit: Fit
    relief: float


def find_suspects(
    problem: Problem, fit: Fit, strange_names: Sequence[str], done: Callable[[int], object] = lambda n: None
) -> list[Suspect]:
    """The effects that make strange nuisance numbers ordinary, most relieving first.

    Every published number is believed to within 35 % here; what stands at zero in the published model is not believed at all, and
    no effect is needed to make that ordinary.

    Args:
        problem: robot, motions and settings.
        fit: the model with nuisance numbers and what is named.
        strange_names: full names of the numbers that are far from the published ones.
        done: called with how many units of work are finished.
    """
    believing = believe_published(problem, fit)
    strange = strangeness(believing, strange_names)
    if strange == 0.0:  # all of them stand at zero in the published model
        return []
    errors = left_out_errors(problem, fit)
    joints = frozenset(joint for name in strange_names for joint in targets_in(name))

    def relieving(trials: Sequence[Trial]) -> list[Suspect]:
        return [
            Suspect(trial.candidate, trial.fit, relief)
            for trial in trials
            if (relief := relief_by(believing, trial.fit)) > EVIDENCE
            and strange - strangeness(trial.fit, strange_names) > HOMEWARD * strange
            and np.sqrt(trial.errors.mean()) < AS_GOOD * np.sqrt(errors.mean())
            and is_usual(problem, trial)  # a negative payload would make most numbers ordinary, and is met in few robots
        ]

    likely = one_each(problem, screen(problem, believing, done), joints)[:REFITTED]
    likely += [one for one in at_the_end(problem, believing, joints) if one.candidate not in [s.candidate for s in likely]]
    found = relieving(refitted_at_home(problem, believing, errors, likely, done))
    found += relieving(in_their_place(problem, believing, errors, strange_names))
    found = list({s.candidate: s for s in sorted(found, key=lambda s: s.relief)}.values())[::-1]
    if found:  # no twin of the best one goes unheard
        best = found[0].candidate
        twins = placed_at(problem, believing, best.targets, confused_with(problem, best.effect))
        effect = load("effects", best.effect, Effect)
        twins += [s for c in on_links(problem, joints, effect) for s in placed_at(problem, believing, c.targets, [effect])]
        heard = [s.candidate for s in (*likely, *found)]
        twins = [one for one in twins if one.candidate not in heard]
        found += relieving(refitted_at_home(problem, believing, errors, twins, done))
    return sorted(found, key=lambda s: -s.relief)


def what_stays(
    problem: Problem, trials: Sequence[Trial], suspects: Sequence[Suspect], first: Float[np.ndarray, "M"]
) -> tuple[list[Suspect], list[Trial]]:
    """What was found behind strange numbers, the best fitted beside those named effects alone that it leaves to explain; and these.

    `first` are the errors of motions left out [rad^2], (M,), with nothing named.
    """
    best, *others = suspects
    fit, kept = backward(problem, best.fit, [*(t.candidate for t in trials), best.candidate], first)
    return [replace(best, fit=fit), *others], [t for t in trials if t.candidate in kept]


def refitted_at_home(
    problem: Problem, believing: Fit, errors: np.ndarray, likely: Sequence[Scored], done: Callable[[int], object]
) -> list[Trial]:
    """Candidates refitted beside published numbers that are believed, those that relieve most patiently."""
    threads, trials = problem.settings.threads, []
    for trial in side_by_side(lambda one: refit(problem, believing, errors, one), likely, threads):
        trials.append(trial)
        done(1)
    most = max((relief_by(believing, trial.fit) for trial in trials), default=0.0)

    def gone_home(trial: Trial) -> Trial:
        """Numbers go home slowly, along a flat valley."""
        slow = relief_by(believing, trial.fit) >= PROMISING * most
        return judged(problem, descend(trial.fit, None, PATIENTLY), errors, trial) if slow else trial

    return list(side_by_side(gone_home, trials, threads))


def in_their_place(problem: Problem, believing: Fit, errors: np.ndarray, strange_names: Sequence[str]) -> list[Trial]:
    """What strange numbers are known to be confused with, gone down from where it is nearest to the motions in their place.

    A dead zone of the servo moves as more dry friction does: beside that the score test sees nothing of it. So those numbers, or
    all of their joints, are put back as published, and the effect in there in several strengths.
    """
    places: list[Scored] = []
    for name in strange_names:
        there = [joint for joint in problem.joints if joint in targets_in(name)]
        places += placed_at(problem, believing, there, confused_with(problem, name.partition(".")[0]))
    places = list({one.candidate: one for one in places}.values())
    joints = frozenset(joint for name in strange_names for joint in targets_in(name))

    def put_back(
        problem: Problem, place: Placement, extended: Objective, absent: Float[np.ndarray, "P"]
    ) -> list[Float[np.ndarray, "P"]]:
        names = extended.simulated.space.names
        home = as_published(problem, names, absent, joints)
        bare = np.where(np.isin(names, list(strange_names)), home, absent)
        return [start for one in (bare, home) for start in in_all_strengths(problem, place, extended, one)]

    nearest = by_nearness(problem, believing, places, put_back)[:NEAREST]
    ends = []
    for _, start, one in nearest:
        extended, _ = extend(believing, [placement(problem, one.candidate)])
        ends.append(judged(problem, descend_from(believing, extended, start, one.candidate, REFITTED), errors, one))
    return ends


def one_each(problem: Problem, scored: Sequence[Scored], joints: frozenset[str]) -> list[Scored]:
    """The best place of every effect that acts on some of these joints, on a link that they carry, or on the world; best first.

    What hides in strange numbers shows little beside them: what the score test is least sure of here is their order.
    """
    acts = [(s, acted_on(s.candidate) | carried_by(problem, s.candidate)) for s in scored]
    there = [s for s, where in acts if not where or where & joints]
    best = {s.candidate.effect: s for s in reversed(there)}
    return [s for s in there if best[s.candidate.effect] is s]


def at_the_end(problem: Problem, fit: Fit, joints: frozenset[str]) -> list[Scored]:
    """What may act on links, on the outermost that these joints carry: there a robot carries what it carries."""
    out = []
    for effect in library(problem):
        if places := on_links(problem, joints, effect):
            out += placed_at(problem, fit, max(places, key=lambda c: len(carried_by(problem, c))).targets, [effect])
    return out


def elsewhere(problem: Problem, fit: Fit, best: Candidate) -> list[Scored]:
    """What may act on links, on the outermost that a candidate's joints carry; a candidate itself on the links next to its own."""
    own = load("effects", best.effect, Effect)
    near = [one for there in next_to(problem, best) for one in placed_at(problem, fit, there.targets, [own])]
    return at_the_end(problem, fit, acted_on(best) | carried_by(problem, best)) + near


def relief_by(believing: Fit, fit: Fit) -> float:
    """By how much a fit with one effect more costs less than the one without it."""
    return cost(replace(believing, scale=fit.scale)) - cost(fit)


def most_ordinary(problem: Problem, fit: Fit) -> Fit:
    """The fit, its numbers as near to the published ones as the recordings allow without being met worse.

    Numbers that are ordinary one and all are an answer where they cost no more than two true simulators differ by. Where nothing
    loads a joint, one factor on all its numbers changes next to no motion, and how two simulators differ decides how large it comes
    out. So that factor goes first otherwise; then priors are made tighter, step by step. All of it as long as it costs next to
    nothing, or no more than a true simulator would leave.
    """
    near = _boxed(problem, fit)
    if near.rms <= max(AS_WELL_MET * fit.rms, float(np.hypot(fit.rms, BENT * problem.settings.model_floor))):
        return freed(polish(near), fit.objective)
    best, most = fit, max(AS_WELL_MET * fit.rms, FLOOR_KNOWN * problem.floor)
    for share in TIGHTER:
        found = [believe_published(problem, best, share)]
        if best is fit:
            found.append(believe_published(problem, brought_home(problem, fit), share))
        met = [one for one in found if one.rms <= most]
        if not met:
            break
        best = min(met, key=lambda one: float(np.abs(list(_ways(problem, one).values())).sum()))
    return best if best is fit else polish(best)


def with_ordinary_numbers(problem: Problem, fit: Fit) -> Fit:
    """The model fitted again to the end, none of its numbers further from the published one than may be expected.

    Guesses and zeros may be anything.
    """
    return freed(polish(_boxed(problem, fit)), fit.objective)


def _boxed(problem: Problem, fit: Fit) -> Fit:
    """A fit in the bounds of ordinary numbers."""
    placements = []
    for place in fit.objective.simulated.placements:
        bounds = {quantity: dict(known) for quantity, known in (place.bounds or {}).items()}
        for parameter in place.effect.parameters(problem.robot.model, place.targets):
            if place.effect.name in problem.settings.nuisance and parameter.start > 0.0 and not parameter.guessed:
                low, high = (factor * parameter.start for factor in ORDINARY)
                own = bounds.setdefault(parameter.name, {})
                own["low"], own["high"] = max(low, own.get("low", parameter.low)), min(high, own.get("high", parameter.high))
                own["start"] = float(np.clip(own.get("start", parameter.start), own["low"], own["high"]))
        if place.effect.name == "viscous" and place.targets in problem.shared:
            least = least_share(problem.robot.model, place.targets[0])
            known = bounds.setdefault("inside", {})
            known["low"], known["start"] = max(least, known.get("low", 0.0)), max(least, known.get("start", least))
        placements.append(replace(place, bounds=bounds))
    boxed = replace(fit.objective, simulated=SimulatedRobot(problem.robot, tuple(placements)), simulations=0)
    return descend(begin(boxed, np.clip(boxed.simulated.space.to_unit(fit.values), 0.0, 1.0)), None)


def least_share(model: mujoco.MjModel, joint: str) -> float:
    """The servo's share [1] of an ordinary damping, above which the joint's own is ordinary, too."""
    index = joint_index(model, joint)
    both = float(model.dof_damping[index["drive"]] - model.actuator_biasprm[index["actuator"], 2])
    return max(1.0 - ordinary_own_damping(model, joint)[1] / (ORDINARY[1] * both), 0.0) if both > 0.0 else 0.0


def ordinary_own_damping(model: mujoco.MjModel, joint: str) -> tuple[float, float]:
    """Between which values a joint's own damping [N m s/rad] may be expected; a little of the whole says nothing."""
    index = joint_index(model, joint)
    own = float(model.dof_damping[index["drive"]])
    little = LITTLE * (own - float(model.actuator_biasprm[index["actuator"], 2]))
    return ORDINARY[0] * own - little, ORDINARY[1] * own + little


def freed(fit: Fit, objective: Objective) -> Fit:
    """A fit found in narrower bounds as one in those of `objective`: the same place and the same slopes, in other units."""
    space, corners = objective.simulated.space, np.array([np.zeros(len(fit.unit)), np.ones(len(fit.unit))])
    widths = np.diff(space.to_unit(fit.space.from_unit(corners)), axis=0)[0]
    unit = np.clip(space.to_unit(fit.values), 0.0, 1.0)
    return replace(fit, objective=objective, unit=unit, jacobian=fit.jacobian / widths)


def brought_home(problem: Problem, fit: Fit) -> Fit:
    """All numbers of each joint divided by one factor, the median of what they are off by: one strange number leaves that alone.

    Where motions tell the servo's share of the damping, it reaches its limit, which knows that factor. What it does is to turn over
    at some ratio of its gain and its own damping: these two go together, to the published gain.
    """
    values, names, ways = fit.values.copy(), fit.space.names, _ways(problem, fit)
    usual = {p.name for p in SimulatedRobot(problem.robot, nuisance_placements(problem)).space.parameters}
    for group in problem.groups:
        own = [i for i, name in enumerate(names) if name in usual and targets_in(name) == set(group)]
        known = [ways[names[i]] for i in own if names[i] in ways]
        numbers = [f"{quantity}[{'+'.join(group)}]" for quantity in SERVO]
        if group in problem.shared and numbers[0] in ways and all(one in names for one in numbers):
            at = [names.index(one) for one in numbers]
            gain, damping, inside = map(float, values[at])
            values[at] = _turned_down(gain, damping, inside, float(np.exp(ways[numbers[0]])))
            continue
        values[own] /= np.exp(np.median(known or [0.0]))
    return begin(fit.objective, np.clip(fit.space.to_unit(values), 0.0, 1.0))


def _turned_down(gain: float, damping: float, inside: float, factor: float) -> tuple[float, float, float]:
    """Gain [N m/rad], damping [N m s/rad] and the servo's share of it, the servo's own two divided by a factor."""
    own, servo = damping * (1.0 - inside), damping * inside / factor
    return gain / factor, own + servo, servo / (own + servo)


def _ways(problem: Problem, fit: Fit) -> dict[str, float]:
    """Logarithm of what each usual number is times its published value, where that is no guess and neither is 0."""
    parameters, found = SimulatedRobot(problem.robot, nuisance_placements(problem)).space.parameters, fit.space.mapping(fit.values)
    known = [p for p in parameters if p.start > 0.0 and not p.guessed and found[p.name] > 0.0]
    return {p.name: float(np.log(found[p.name] / p.start)) for p in known}


def believe_published(problem: Problem, fit: Fit, share: float | None = None) -> Fit:
    """The same model, named effects included, fitted again under priors at the published numbers.

    Args:
        problem: robot, motions and settings.
        fit: where to begin.
        share: the priors are so many times as wide as usual, and wider for a number that is far off already (as a Cauchy prior
            would have it), so that it does not take others along; None for the usual ones.
    """
    bare = SimulatedRobot(problem.robot, nuisance_placements(problem))
    without_prior = [p for p in bare.space.parameters if not (p.guessed and np.isfinite(p.spread))]
    published = {p.name: 0.0 if p.guessed else p.start for p in without_prior}
    found, scales = fit.space.mapping(fit.values), {p.name: p.scale for p in bare.space.parameters}
    placements = []
    for place in nuisance_placements(problem, published):
        bounds = {}
        for quantity, known in (place.bounds or {}).items():
            name = place.full_name(quantity)
            if name not in published:
                continue
            if published[name] <= 0.0:
                bounds[quantity] = {"start": known["start"]}
                continue
            bounds[quantity] = dict(known)
            if share is not None:
                away = np.log(found[name] / published[name]) if scales[name] == "log" else found[name] - published[name]
                bounds[quantity]["spread"] = share * float(np.hypot(known["spread"], away))
        placements.append(replace(place, bounds=bounds))
    placements += [one for one in fit.objective.simulated.placements if one.effect.name not in problem.settings.nuisance]
    objective = replace(fit.objective, simulated=SimulatedRobot(problem.robot, tuple(placements)), simulations=0)
    return descend(replace(fit, objective=objective), None, iterations=3)


def strangeness(fit: Fit, names: Sequence[str]) -> float:
    """How far some numbers lie from what is believed: -2 log prior."""
    centre, spread = fit.space.unit_prior()
    known = np.isfinite(spread) & np.isin(fit.space.names, list(names))
    return float((((fit.unit - centre) / spread)[known] ** 2).sum())
