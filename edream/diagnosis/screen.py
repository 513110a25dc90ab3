"""Score test: which candidate's fingerprint is in what the nuisance numbers cannot explain?

At the best fit without the candidate let r be the residual and J its Jacobian. A probe simulation with a little of the candidate
changes the residual by D. Project J out of both (the nuisance numbers would take that part). What is believed of these numbers
beforehand counts as further rows: how far they were pushed, which a candidate does not change by itself. The share of r that the
candidate can explain, to first order, is

    share = (D' . r')^2 / (|D'|^2 |r'|^2),   and its size is alpha = - (D' . r') / |D'|^2 probes.

Source: Rao's score test, Mathematical Proceedings of the Cambridge Philosophical Society 44(1), 1948.
"""

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from mujoco import batch

from edream.core.effect import Effect
from edream.core.errors import EdreamError
from edream.core.parameters import Parameter, targets_in
from edream.diagnosis.candidates import Candidate, acted_on, alike, groups_of, library, placement, probes_of, rounds
from edream.diagnosis.descent import Fit
from edream.diagnosis.few import ENOUGH, thinned
from edream.diagnosis.problem import Problem
from edream.diagnosis.side_by_side import side_by_side
from edream.diagnosis.steps import with_long_steps
from edream.sim.objective import Objective
from edream.sim.simulation import Placement, SimulatedRobot, write_fields

FINALISTS = 16
WORTH_A_LOOK = 0.002  # share
TOGETHER = 1.2  # times the share of the best single joint, from which several that are not tied are tried as one
SCANNED = 20.0  # s of motion that tells lengths of waves
Unexplained = Callable[[Float[np.ndarray, "N R"]], Float[np.ndarray, "N"]]
log = logging.getLogger(__name__)
LARGEST_ALPHA = 20.0
WIDE, CLOSE = (0.5, 1.8), (0.5, 0.7, 0.8, 0.9, 1.1, 1.2, 1.35, 1.8)  # other sizes tried of an effect; of a limit
HARDLY = 0.1  # of the best share: what explains less is looked at in one size alone
MOST = 0.5  # of the gap: where something else explains as much, lengths of waves are not gone through
LIKE = 0.75  # of what that explains: a wave that does as much at a wrong length may do more at its own


@dataclass(frozen=True, eq=False)
class Scored:
    """A candidate and how much of the gap its fingerprint explains.

    Attributes:
        candidate: effect and place.
        start: its quantities, where a refit had best begin.
        share: share of the squared residual that it explains at `start`, 0 to 1.
    """

    candidate: Candidate
    start: Mapping[str, float]
    share: float


def screen(problem: Problem, fit: Fit, done: Callable[[int], object] = lambda n: None) -> list[Scored]:
    """Every effect at every place, best first. Calls `done(n)` as n rounds are finished."""
    fit = lightened(problem, fit)
    unexplained = unexplained_by(fit)
    total = float(unexplained(fit.residual[None])[0])
    present = fit.objective.simulated.placements

    def probed(one: Sequence[Candidate]) -> list[Scored]:
        fresh = [c for c in one if not acts_already(c, present)]
        if fresh and not fits_beside(problem, fit, fresh):
            fresh = [c for c in fresh if fits_beside(problem, fit, [c])]
        return _probe_round(problem, fit, fresh, total) if fresh else []

    first: list[Scored] = []
    for found in side_by_side(probed, rounds(problem, library(problem)), problem.settings.threads):
        first += found
        done(1)
    last = with_scan(problem, fit, finalists(worthwhile(problem, first)))
    most = max((s.share for s in last), default=0.0)
    second = side_by_side(lambda s: confirm(problem, fit, s, most, unexplained, total), last, problem.settings.threads)
    out = sorted((s for s in second if s is not None), key=lambda s: -s.share)
    done(1)
    return out


def lightened(problem: Problem, fit: Fit) -> Fit:
    """The fit as first looks need it: on a few of its motions, in steps as long as the published ones."""
    return with_long_steps(problem, thinned(fit, ENOUGH))


def worthwhile(problem: Problem, scored: Sequence[Scored]) -> list[Scored]:
    """All but the sets of joints that are not known to share hardware and explain hardly more together than one of them alone."""
    loose = alike(problem)
    alone: dict[str, float] = {}
    for one in scored:
        if len(one.candidate.targets) < 2:
            alone[one.candidate.effect] = max(one.share, alone.get(one.candidate.effect, 0.0))
    return [s for s in scored if s.candidate.targets not in loose or s.share > TOGETHER * alone.get(s.candidate.effect, 0.0)]


def finalists(scored: Sequence[Scored]) -> list[Scored]:
    """Those with the largest shares, and the best of each effect on one joint and on a hardware group."""
    ranked = sorted((s for s in scored if s.share > 0.0), key=lambda s: -s.share)
    alone = {s.candidate.effect: s for s in reversed(ranked) if len(s.candidate.targets) < 2}
    grouped = {s.candidate.effect: s for s in reversed(ranked) if len(s.candidate.targets) > 1 and s.share > WORTH_A_LOOK}
    return ranked[:FINALISTS] + [s for s in (*alone.values(), *grouped.values()) if s not in ranked[:FINALISTS]]


def acts_already(candidate: Candidate, present: Sequence[Placement]) -> bool:
    """Whether the model has the effect already where the candidate would put it."""
    return any(
        p.effect.name == candidate.effect and (not candidate.targets or set(p.targets) & set(candidate.targets)) for p in present
    )


def fits_beside(problem: Problem, fit: Fit, candidates: Sequence[Candidate]) -> bool:
    """Whether MuJoCo has a form for these candidates together with the effects that the model has already."""
    extended, absent = extend(fit, [placement(problem, c) for c in candidates])
    simulated = extended.simulated
    try:
        one = batch.Batch(simulated.model, 1, 1)
        write_fields(simulated, one, simulated.quantities(absent[None], [extended.windows[0].episode.conditions]))
    except EdreamError as reason:
        log.info("%s is not tried: %s", candidates[0].effect, reason)
        return False
    return True


def prior_rows(fit: Fit) -> tuple[Float[np.ndarray, "P"], Float[np.ndarray, "P P"]]:
    """The prior as residual rows [rad] at the fit, and their Jacobian."""
    centre, spread = fit.space.unit_prior()
    weight = np.where(np.isfinite(spread), fit.scale / spread, 0.0)
    return weight * (fit.unit - centre), np.diag(weight)


class Projection:
    """Takes out of a residual what a linear change of the nuisance numbers explains."""

    def __init__(self, columns: Float[np.ndarray, "R P"]) -> None:
        scale = np.linalg.norm(columns, axis=0)
        kept = columns[:, scale > 0.0] / scale[scale > 0.0]
        basis, size, _ = np.linalg.svd(kept, full_matrices=False) if kept.size else (kept, np.zeros(0), None)
        self.basis = basis[:, size > 1e-6 * size.max(initial=0.0)]

    def out(self, vector: Float[np.ndarray, "R"]) -> Float[np.ndarray, "R"]:
        return vector - self.basis @ (self.basis.T @ vector)


def unexplained_by(fit: Fit) -> Unexplained:
    """Says how much of some residuals, as sums of squares, no linear change of the nuisance numbers explains."""
    away, pull = prior_rows(fit)
    base = Projection(np.vstack([fit.jacobian, pull]))
    return lambda residuals: np.array([float(np.sum(base.out(np.concatenate([r, away])) ** 2)) for r in residuals])


def _probe_round(problem: Problem, fit: Fit, candidates: Sequence[Candidate], total: float) -> list[Scored]:
    """All candidates of a round probed at once; each is judged on the residual of its own joint, a hardware group on all of its.

    Where what one of them does shows on the joints of others, this tells of their groups alone.
    """
    placements = [placement(problem, c) for c in candidates]
    extended, absent = extend(fit, placements)
    probes = [probes_of(problem, p) for p in placements]
    count = max(len(p) for p in probes)
    sets = [absent] + [with_quantities(extended, absent, placements, [p[min(i, len(p) - 1)] for p in probes]) for i in range(count)]
    residuals = extended.residuals(np.array(sets))
    changes = residuals[1:] - residuals[0]
    present = fit.objective.simulated.placements
    groups = [group for group in groups_of(problem, candidates) if not acts_already(group, present)]
    mixed = len(candidates) > 1 and placements[0].effect.shifts_links
    return [scored_probes(problem, fit, c, residuals[0], changes, total) for c in (*(() if mixed else candidates), *groups)]


def with_scan(problem: Problem, fit: Fit, finalists: Sequence[Scored]) -> list[Scored]:
    """The finalists, the likeliest wave among them probed at every length: no slope leads from one to the next.

    Not so where something else explains most of the gap, and clearly more than a wave of a length that is not its own may: what is
    left of it then is for a further round.
    """
    waves_ = [s for s in finalists if placement(problem, s.candidate).effect.phase is not None]
    best = max(waves_, key=lambda s: s.share, default=None)
    others = max((s.share for s in finalists if s not in waves_), default=0.0)
    return [scanned(problem, fit, s) if s is best and others < max(MOST, s.share / LIKE) else s for s in finalists]


def scanned(problem: Problem, fit: Fit, scored: Scored) -> Scored:
    """A wave probed at every length that can be told from its neighbours over the joint's travel, on a little of the motion."""
    few = thinned(fit, SCANNED)
    place = placement(problem, scored.candidate)
    fine = place.effect.scan(problem.robot.model, place.targets)
    extended, absent = extend(few, [place])
    sets = [absent, *(with_quantities(extended, absent, [place], [one]) for one in (*fine, scored.start))]
    residuals = extended.residuals(np.array(sets))
    total = float(unexplained_by(few)(residuals[:1])[0])
    found = scored_probes(problem, few, scored.candidate, residuals[0], residuals[1:-1] - residuals[0], total, fine)
    gained = 1.0 - float(unexplained_by(few)(residuals[-1:])[0]) / total
    return replace(scored, start=found.start) if found.share > gained else scored


def scored_probes(
    problem: Problem,
    fit: Fit,
    candidate: Candidate,
    residual: Float[np.ndarray, "R"],
    changes: Float[np.ndarray, "K R"],
    total: float,
    probes: Sequence[Mapping[str, float]] | None = None,
) -> Scored:
    """The share of the residual that a candidate's best probe points at, and where that puts its quantities.

    `changes` are what the candidate's own probes change, or `probes` where they are given.
    """
    place = placement(problem, candidate)
    own = probes or probes_of(problem, place)
    rows, columns = _own_rows(problem, fit, candidate)
    away, pull = prior_rows(fit)
    projection = Projection(np.vstack([fit.jacobian[np.ix_(rows, columns)], pull[np.ix_(columns, columns)]]))
    here = projection.out(np.concatenate([residual[rows], away[columns]]))
    best = Scored(candidate, own[0], 0.0)
    moved = [projection.out(np.concatenate([change[rows], np.zeros(len(columns))])) for change in changes[: len(own)]]
    for probe, change in waves(place.effect, own, moved, here):
        size = float(change @ change)
        if size <= 1e-16 * len(rows):
            continue
        alpha = -float(change @ here) / size
        start = scaled_probe(place, problem, probe, alpha)
        share = float(change @ here) ** 2 / size / total
        if start is not None and share > best.share:
            best = Scored(candidate, start, share)
    return best


def waves(
    effect: Effect, probes: Sequence[Mapping[str, float]], changes: Sequence[np.ndarray], residual: np.ndarray
) -> list[tuple[Mapping[str, float], np.ndarray]]:
    """Probes and what each changes; where an effect has a phase, two that are a quarter turn apart become the one of best phase.

    A sin(x + phi) = A cos(phi) sin(x) + A sin(phi) cos(x): two simulations stand for every phase, both signs included.
    """
    if effect.phase is None:
        return list(zip(probes, changes, strict=True))
    out = []
    for probe, sine, cosine in zip(probes[::2], changes[::2], changes[1::2], strict=True):
        (a, b), *_ = np.linalg.lstsq(np.stack([sine, cosine], axis=1), -residual, rcond=None)
        angle = float(np.arctan2(b, a))
        out.append(({**probe, effect.phase: angle}, np.cos(angle) * sine + np.sin(angle) * cosine))
    return out


def _own_rows(problem: Problem, fit: Fit, candidate: Candidate) -> tuple[np.ndarray, np.ndarray]:
    """Residual rows and nuisance columns that concern the joints that a candidate acts on; all, where it acts on none."""
    targets = acted_on(candidate)
    counted = [number for number, joint in enumerate(problem.joints) if joint in targets]
    every_column = np.arange(len(fit.unit))
    if not counted:
        return np.arange(len(fit.residual)), every_column
    rows = np.flatnonzero(np.isin(np.arange(len(fit.residual)) % len(problem.joints), counted))
    columns = np.flatnonzero([not targets.isdisjoint(targets_in(name)) for name in fit.space.names])
    return rows, columns if len(columns) else every_column


def confirm(problem: Problem, fit: Fit, scored: Scored, most: float, unexplained: Unexplained, total: float) -> Scored | None:
    """A candidate alone, simulated where the score test puts it; None where nothing helps.

    Other sizes are tried, too, where either of the two tests gives it a share worth it beside the best one's, `most`.
    """
    place = placement(problem, scored.candidate)
    extended, absent = extend(fit, [place])

    def shares(factors: Sequence[float]) -> list[Scored]:
        starts = [s for factor in factors if (s := scaled_probe(place, problem, scored.start, factor)) is not None]
        if not starts:
            return []
        left = unexplained(extended.residuals(np.array([with_quantities(extended, absent, [place], [one]) for one in starts])))
        return [Scored(scored.candidate, start, 1.0 - float(one) / total) for start, one in zip(starts, left, strict=True)]

    found = shares([1.0])
    if max([scored.share, *(one.share for one in found)]) >= HARDLY * most:
        limits = any(is_limit(parameter) for parameter in place.effect.parameters(problem.robot.model, place.targets))
        found += shares(CLOSE if limits else WIDE)
    best = max(found, key=lambda one: one.share, default=None)
    return best if best is not None and best.share > 0.0 else None


def extend(fit: Fit, placements: Sequence[Placement]) -> tuple[Objective, Float[np.ndarray, "P"]]:
    """The fit's model with more effects, and its parameter set with all of them absent."""
    simulated = fit.objective.simulated
    longer = simulated.with_placements([*simulated.placements, *placements])
    start = np.concatenate([fit.values, absent_values(longer, placements)])
    return replace(fit.objective, simulated=longer, simulations=0), start


def absent_values(simulated: SimulatedRobot, placements: Sequence[Placement]) -> Float[np.ndarray, "Q"]:
    """The parameters of some placements at the values at which their effects are not there."""
    parameters = [p for place in placements for p in place.parameters(simulated.robot.model)]
    return np.array([p.start if p.absent is None else p.absent for p in parameters])


def with_quantities(
    extended: Objective, absent: Float[np.ndarray, "P"], placements: Sequence[Placement], quantities: Sequence[Mapping[str, float]]
) -> Float[np.ndarray, "P"]:
    """A parameter set with some placements' quantities put in."""
    values = absent.copy()
    names = extended.simulated.space.names
    for place, numbers in zip(placements, quantities, strict=True):
        for quantity, number in numbers.items():
            values[names.index(place.full_name(quantity))] = number
    return values


def is_limit(parameter: Parameter) -> bool:
    """Whether a quantity is absent where it is large, and does nothing until a motion reaches it."""
    return parameter.scale == "log" and parameter.absent == parameter.high


def scaled_probe(place: Placement, problem: Problem, probe: Mapping[str, float], factor: float) -> dict[str, float] | None:
    """A probe made `factor` times as strong, inside the box; None where that would take it out on the absent side."""
    out = dict(probe)
    factor = float(np.clip(factor, -LARGEST_ALPHA, LARGEST_ALPHA))
    moved = False
    for parameter in place.effect.parameters(problem.robot.model, place.targets):
        if parameter.absent is None:
            continue
        if np.isinf(parameter.absent) or parameter.name not in probe:
            continue
        if is_limit(parameter):  # from far above the motions down by ratios
            value = parameter.absent * (probe[parameter.name] / parameter.absent) ** factor
        else:
            value = parameter.absent + factor * (probe[parameter.name] - parameter.absent)
        out[parameter.name] = float(np.clip(value, parameter.low, parameter.high))
        moved |= abs(out[parameter.name] - parameter.absent) > 1e-9
    return out if moved else None
