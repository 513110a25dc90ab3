"""Where a candidate's refit begins: its quantities, and the usual numbers beside it as fitted or as published."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Bool, Float

from edream.core.parameters import targets_in
from edream.diagnosis.candidates import Candidate, acted_on, probes_of
from edream.diagnosis.descent import Fit
from edream.diagnosis.problem import Problem, nuisance_placements
from edream.diagnosis.screen import LARGEST_ALPHA, Scored, scaled_probe, with_quantities
from edream.sim.differences import inwards
from edream.sim.least_squares import worth
from edream.sim.objective import Objective
from edream.sim.simulation import Placement, SimulatedRobot

STRONG = 5.0  # probes


def bold_starts(
    problem: Problem, place: Placement, scored: Scored, extended: Objective, absent: Float[np.ndarray, "P"]
) -> list[Float[np.ndarray, "P"]]:
    """Parameter sets: where the score test says, and strong versions; each also with little of the friction it may replace."""
    quantities = [scored.start, *strong_probes(problem, place)[:4]]
    starts = [with_quantities(extended, absent, [place], [one]) for one in quantities]
    names = extended.simulated.space.names
    friction = np.array([name.startswith("coulomb.") for name in names])
    return [*starts, *(np.where(friction, 0.2 * start, start) for start in starts if friction.any())]


def beside_published(
    problem: Problem, place: Placement, extended: Objective, absent: Float[np.ndarray, "P"]
) -> list[Float[np.ndarray, "P"]]:
    """Every probe of a candidate, its joints' usual numbers as published; all joints', where it acts on none.

    Those that were fitted without it may have gone far to make up for it.
    """
    believed = _believed(problem, place, extended, absent)
    return [with_quantities(extended, believed, [place], [one]) for one in probes_of(problem, place)]


def in_all_strengths(
    problem: Problem, place: Placement, extended: Objective, absent: Float[np.ndarray, "P"]
) -> list[Float[np.ndarray, "P"]]:
    """Every probe of a candidate, weak to as strong as motors are, beside the usual numbers as they are."""
    stronger = [one for strength in (STRONG, LARGEST_ALPHA) for one in strong_probes(problem, place, strength)]
    return [with_quantities(extended, absent, [place], [one]) for one in (*probes_of(problem, place), *stronger)]


def in_all_strengths_beside_published(
    problem: Problem, place: Placement, extended: Objective, absent: Float[np.ndarray, "P"]
) -> list[Float[np.ndarray, "P"]]:
    """Every probe of a candidate, weak to as strong as motors are, beside its joints' usual numbers as published."""
    return in_all_strengths(problem, place, extended, _believed(problem, place, extended, absent))


def either_way(
    problem: Problem, place: Placement, extended: Objective, absent: Float[np.ndarray, "P"]
) -> list[Float[np.ndarray, "P"]]:
    """Every probe of a candidate and its opposite, weak and strong, beside the usual numbers as they are and as published."""
    factors = [sign * strength for sign in (1.0, -1.0) for strength in (1.0, STRONG)]
    scaled = [scaled_probe(place, problem, probe, factor) for probe in probes_of(problem, place) for factor in factors]
    usual = (absent, _believed(problem, place, extended, absent))
    return [with_quantities(extended, numbers, [place], [one]) for numbers in usual for one in scaled if one is not None]


def _believed(problem: Problem, place: Placement, extended: Objective, absent: Float[np.ndarray, "P"]) -> Float[np.ndarray, "P"]:
    """Parameter values, the usual numbers of the joints that a candidate acts on as published; of all, where it acts on none."""
    joints = acted_on(Candidate(place.effect.name, tuple(place.targets)))
    return as_published(problem, extended.simulated.space.names, absent, joints)


def as_published(
    problem: Problem, names: Sequence[str], values: Float[np.ndarray, "P"], joints: frozenset[str]
) -> Float[np.ndarray, "P"]:
    """Parameter values, the usual numbers of some joints as the model publishes them; of all, where none are given."""
    space = SimulatedRobot(problem.robot, nuisance_placements(problem)).space
    joints = joints or frozenset(problem.joints)
    told = {name: value for name, value in space.mapping(space.start()).items() if not joints.isdisjoint(targets_in(name))}
    return np.array([told.get(name, value) for name, value in zip(names, values, strict=True)])


def shapes(problem: Problem, place: Placement, start: Mapping[str, float]) -> list[dict[str, float]]:
    """A candidate's quantities as they are, and with the same strength in the shape of each of its probes (a speed, a place)."""
    parameters = place.effect.parameters(problem.robot.model, place.targets)
    form = [p.name for p in parameters if p.absent is None]
    others = [{**start, **{name: probe[name] for name in form if name in probe}} for probe in probes_of(problem, place)]
    return [one for i, one in enumerate([dict(start), *others]) if one not in [dict(start), *others][:i]]


def strong_probes(problem: Problem, place: Placement, strength: float = STRONG) -> list[dict[str, float]]:
    """The probes made strong, inside the box; those that end in the same corner of it count once."""
    scaled = [scaled_probe(place, problem, probe, strength) for probe in probes_of(problem, place)]
    return [one for i, one in enumerate(scaled) if one is not None and one not in scaled[:i]]


def beside_either(
    problem: Problem, place: Placement, extended: Objective, absent: Float[np.ndarray, "P"], ended: Mapping[str, float]
) -> list[Float[np.ndarray, "P"]]:
    """An effect with the numbers that it ended with elsewhere, beside usual numbers as they are here, and as they were there, (P,).

    `ended`: full parameter name -> value there.
    """
    own = {parameter.name for parameter in place.parameters(problem.robot.model)}
    names = extended.simulated.space.names
    return [np.array([ended.get(n, v) if n in of else v for n, v in zip(names, absent, strict=True)]) for of in (own, ended)]


def with_column(fit: Fit, extended: Objective, start: Float[np.ndarray, "P"], fresh: Bool[np.ndarray, "P"] | None = None) -> Fit:
    """The fit at a larger model's starting point: columns in `fresh`, the candidate's at least, are differenced, others kept."""
    space = extended.simulated.space
    unit = np.clip(space.to_unit(start), 0.0, 1.0)
    new = np.flatnonzero(fresh_columns(fit, extended) if fresh is None else fresh)
    steps = inwards(extended, unit)
    residuals = extended.residuals(space.from_unit(np.vstack([unit, unit + np.diag(steps)[new]])))
    slope = np.hstack([fit.jacobian, np.zeros((len(residuals[0]), len(unit) - len(fit.unit)))])
    slope[:, new] = ((residuals[1:] - residuals[0]) / steps[new, None]).T
    return Fit(extended, unit, residuals[0], slope, worth(extended, residuals[0]))


def of_joints(objective: Objective, joints: frozenset[str]) -> Bool[np.ndarray, "P"]:
    """Which parameters act on some of these joints."""
    return np.array([not joints.isdisjoint(targets_in(name)) for name in objective.simulated.space.names])


def fresh_columns(fit: Fit, extended: Objective) -> Bool[np.ndarray, "P"]:
    """Which parameters a larger model has more than the fit's."""
    return np.arange(len(extended.simulated.space)) >= len(fit.unit)
