"""What is left and has no name: a short formula for it, found by sparse regression in the simulator's own response.

Each feature is a torque on the joint with the largest gap, such as a bump over its angle. A probe simulation gives what a
little of it does to the motion; orthogonal matching pursuit picks the few whose responses explain the residual, so many as
predict motions that they were not picked on; their coefficients are refitted with all nuisance numbers free. Source: Pati,
Rezaiifar, Krishnaprasad, Asilomar 1993 (matching pursuit); Brunton, Proctor, Kutz, PNAS 113(15), 2016 (sparse identification of
dynamics).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import mujoco
import numpy as np
from jaxtyping import Float

from edream.core.effect import Effect, State
from edream.core.parameters import Parameter
from edream.diagnosis.descent import Fit, descend
from edream.diagnosis.few import thinned
from edream.diagnosis.left_out import bootstrap, folds, is_real, is_small, left_out_errors, worst_joint
from edream.diagnosis.problem import Problem
from edream.diagnosis.screen import Projection, extend
from edream.diagnosis.starts import fresh_columns, with_column
from edream.diagnosis.steps import with_long_steps
from edream.diagnosis.swings import frequencies_in_step
from edream.sim.scales import torque_scale
from edream.sim.simulation import Placement

NARROW, WIDE = 16, 5  # bumps over a joint's travel, of two widths
MOST_TERMS = 8
LOOKS = 3  # at most
ARRIVING, NEARER = 8, 3  # steps of all numbers, of a model with few, and with many
OPEN = 0.01  # of the squared gap above the floor: a formula that leaves less is not looked at again
ENOUGH = 50.0  # s of motion on which terms are chosen
SMALLEST_GAIN = 0.03  # share of the residual that a further term must explain
FEATURES = (
    "constant",
    "angle",
    "speed",
    "speed_size",
    "drag",
    "direction",
    "direction_angle",
    "load",
    "direction_load",
    "speed_load",
    "error",
    "error_drag",
    "error_angle",
    "time",
    "direction_time",
)
BUMPED = ("bump", "direction_bump", "speed_bump", "motor_bump")
# beyond a place: a stop, a cable that goes taut
EDGED = ("over", "under", "speed_over", "speed_under", "direction_over", "direction_under")
WAVES = ("sine", "cosine")
DEEP = 0.03  # rad beyond an edge
BESIDE = 0.15  # rad, in which an edge or a bump is refitted
WIDER = 3.0  # times as wide or as narrow a bump may become
NEAR = 0.05  # Hz: half of what motions of ten seconds can tell apart, in which a frequency is refitted
RECENT = (0.5, 2.0, 10.0)  # s, over which a joint's speed may be remembered: what warms up, or settles


def residual_torque(state: State, index: dict[str, int], values: Mapping[str, Any]) -> None:
    """A torque that no named effect explains, as a sum of simple terms."""
    q, v = state.qpos[:, index["qpos"]], state.qvel[:, index["dof"]]
    load = state.qfrc_bias[:, index["dof"]]
    error, motor = state.ctrl[:, index["ctrl"]] - q, state.actuator_force[:, index["force"]]
    direction = np.tanh(v / 0.02)
    terms = {
        "constant": 1.0,
        "angle": q,
        "speed": v,
        "speed_size": abs(v),
        "drag": v * abs(v),
        "direction": direction,
        "direction_angle": direction * q,
        "load": load,
        "direction_load": direction * abs(load),
        "speed_load": v * abs(load),
        "error": error,
        "error_drag": error * abs(error),
        "error_angle": error * q,
        "time": state.time,
        "direction_time": direction * state.time,
    }
    torque = 0.0
    for name, coefficient in values.items():
        kind, _, rest = name.partition("_at_")
        if name in terms:
            torque = torque + coefficient * terms[name]
        elif kind in ("bump", "direction_bump", "speed_bump", "motor_bump"):
            shape = np.exp(-0.5 * ((q - values["centre_" + rest]) / values["width_" + rest]) ** 2)
            what = {"bump": 1.0, "direction_bump": direction, "speed_bump": v, "motor_bump": motor}[kind]
            torque = torque + coefficient * shape * what
        elif kind.endswith(("over", "under")):
            beyond = q - values["edge_" + rest] if kind.endswith("over") else values["edge_" + rest] - q
            what = {"speed": v, "direction": direction}.get(kind.partition("_")[0], 1.0)
            torque = torque + coefficient * np.maximum(beyond, 0.0) * what
        elif kind in ("sine", "cosine"):
            phase = 2.0 * np.pi * values["frequency_" + rest] * state.time
            torque = torque + coefficient * (np.sin(phase) if kind == "sine" else np.cos(phase))
        elif kind in ("direction_recent", "speed_recent"):
            lately = state.recent(index["dof"], float(rest))
            torque = torque + coefficient * lately * (direction if kind == "direction_recent" else v)
        elif kind in ("other_angle", "direction_other", "other_speed", "speed_product", "speed_other"):
            dof = int(rest)
            other = state.qpos[:, dof] if kind in ("other_angle", "direction_other") else state.qvel[:, dof]
            products = {"direction_other": direction * other, "speed_product": other * v, "speed_other": abs(other) * v}
            torque = torque + coefficient * products.get(kind, other)
    state.torque[:, index["dof"]] += torque


class ResidualTorque(Effect):
    """A sum of torque terms on one joint, each with its own coefficient; the terms are chosen per instance.

    `shape` has centres and widths of bumps and edges [rad], and frequencies of waves [Hz]; all are refitted, unless held.
    """

    name = "residual_torque"
    summary = "a torque that has no name"
    place = "joint"
    hook = staticmethod(residual_torque)

    def __init__(
        self, terms: Sequence[str], scales: Sequence[float], shape: Mapping[str, float], name: str = "residual_torque"
    ) -> None:
        self.name = name
        self.terms, self.scales, self.shape = tuple(terms), tuple(scales), dict(shape)

    def parameters(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[Parameter, ...]:
        """One coefficient a term, in units that give a torque, and the shape of bumps [rad] and waves [Hz]."""
        torque = torque_scale(model, targets[0])
        terms = [
            Parameter(name, "N m per term", -3.0 * torque / s, 3.0 * torque / s, 0.0, absent=0.0, spread=torque / s)
            for name, s in zip(self.terms, self.scales, strict=True)
        ]
        return (*terms, *(_shaped(name, value) for name, value in self.shape.items()))


def _shaped(name: str, value: float) -> Parameter:
    if name.startswith("width_"):
        return Parameter(name, "rad", value / WIDER, value * WIDER, value, scale="log")
    unit, away = ("Hz", NEAR) if name.startswith("frequency_") else ("rad", BESIDE)
    return Parameter(name, unit, value - away, value + away, value)


@dataclass(frozen=True, eq=False)
class Remainder:
    """A gap without a name.

    Attributes:
        joint: where it is largest.
        formula: the torque that describes it [N m].
        placement: the term as something that can be simulated.
        fit: the model with the term.
        errors: left-out mean squared errors with it [rad^2], (M,).
        real: whether left-out motions confirm it.
        beside_names: whether it describes what named effects leave, rather than the whole gap.
    """

    joint: str
    formula: str
    placement: Placement
    fit: Fit
    errors: Float[np.ndarray, "M"]
    real: bool
    beside_names: bool = False


def find_remainder(problem: Problem, fit: Fit, beside_names: bool = False) -> Remainder | None:
    """Describe what is left on the joint where most is left; None where no term explains enough."""
    found = _found(problem, fit)
    return None if found is None else replace(found, beside_names=beside_names)


@lru_cache(maxsize=2)  # one model is asked about twice in a diagnosis: beside its candidates, and where none stood
def _found(problem: Problem, fit: Fit) -> Remainder | None:
    """A formula; where it leaves a gap, terms are looked for again from its numbers, where their responses are other ones."""
    joint, before = worst_joint(problem, fit), left_out_errors(problem, fit)
    found = None
    for _ in range(LOOKS):
        if (longer := _longer(problem, fit, joint, found)) is None:
            break
        refitted, small = longer
        if found is not None and refitted.rms >= found.fit.rms:  # the further terms came to nothing
            break
        errors = left_out_errors(problem, refitted)
        if found is not None and not errors.mean() < found.errors.mean():
            break
        low, _ = bootstrap(before - errors, problem.settings.seed)
        gap, left = (max(float(e.mean()) - problem.floor**2, 1e-18) for e in (before, errors))
        real = low > 0.0 and float((before - errors).mean()) / gap >= problem.settings.gain
        found = Remainder(joint, _formula(refitted, small), small, refitted, errors, real)
        if real and (left < OPEN * gap or not is_real(problem, errors)):
            break
    return found


def _longer(problem: Problem, fit: Fit, joint: str, found: Remainder | None) -> tuple[Fit, Placement] | None:
    """The fit with further terms beside those found, refitted, and all of them as what it has more; None where none helps."""
    base, old = (fit, []) if found is None else (found.fit, list(_torque(found.placement).terms))
    shape, names = _candidates(problem, fit, joint)
    candidates = [name for name in names if name not in old]
    scales = _scales(problem, joint, candidates)
    looked = with_long_steps(problem, thinned(base, ENOUGH))
    everything = ResidualTorque(candidates, scales, shape, "further_torque")
    extended, absent = extend(looked, [Placement(everything, (joint,), fixed=shape)])
    steps = 0.05 * torque_scale(problem.robot.model, joint) / np.array(scales)
    sets = np.repeat(absent[None], len(candidates) + 1, axis=0)
    sets[1:, len(base.unit) :] += np.diag(steps)
    chosen = chosen_terms(problem, looked, extended.residuals(sets), MOST_TERMS - len(old))
    if not chosen:
        return None
    terms = [*old, *(candidates[i] for i in chosen)]
    places = {n.partition("_at_")[2] for n in terms if n.partition("_at_")[0] in (*BUMPED, *EDGED, *WAVES)}
    used = {key: value for key, value in shape.items() if key.partition("_")[2] in places}
    small = Placement(ResidualTorque(terms, _scales(problem, joint, terms), used), (joint,))
    begun, zero = extend(fit, [small])
    so_far = base.space.mapping(base.values)
    start = np.array([so_far.get(name, value) for name, value in zip(begun.simulated.space.names, zero, strict=True)])
    fresh = fresh_columns(fit, begun)
    near = descend(with_column(base, begun, start, fresh), fresh, iterations=6)
    return descend(near, None, ARRIVING if is_small(fit) else NEARER), small  # usual numbers may have made up for most of it


def _torque(placement: Placement) -> ResidualTorque:
    assert isinstance(placement.effect, ResidualTorque)
    return placement.effect


def _candidates(problem: Problem, fit: Fit, joint: str) -> tuple[dict[str, float], list[str]]:
    """Centres and widths of bumps over the visited range of the joint [rad], frequencies of waves [Hz], and all terms' names."""
    column = problem.fitted[0].episode.joints.index(joint)
    visited = np.concatenate([w.measured[:, column] for w in problem.fitted])
    low, high = np.percentile(visited, [1, 99])
    shape = {}
    for count in (NARROW, WIDE):
        width = max(float((high - low) / (count - 1)) * 0.7, 1e-3)
        for centre in np.linspace(low, high, count):
            number = len(shape) // 2
            shape |= {f"centre_{number}": float(centre), f"width_{number}": width}
    shape |= {f"edge_e{i}": float(edge) for i, edge in enumerate(np.linspace(low, high, NARROW))}
    waves = {f"wave{i}": frequency for i, frequency in enumerate(frequencies_in_step(problem, fit, joint))}
    shape |= {f"frequency_{name}": frequency for name, frequency in waves.items()}
    model = problem.robot.model
    others = [int(model.jnt_dofadr[model.joint(name).id]) for name in problem.joints if name != joint]
    names = list(FEATURES)
    names += [f"{kind}_at_{i}" for kind in BUMPED for i in range(NARROW + WIDE)]
    names += [f"{kind}_at_e{i}" for kind in EDGED for i in range(NARROW)]
    names += [f"{kind}_at_{wave}" for kind in WAVES for wave in waves]
    crossed = ("other_angle", "direction_other", "other_speed", "speed_product", "speed_other")
    names += [f"{kind}_at_{dof}" for kind in crossed for dof in others]
    names += [f"{kind}_at_{seconds:g}" for kind in ("direction_recent", "speed_recent") for seconds in RECENT]
    return shape, names


def _scales(problem: Problem, joint: str, names: Sequence[str]) -> list[float]:
    """How large each term typically is, so that coefficients are searched on a torque's scale."""
    load = max(torque_scale(problem.robot.model, joint), 1e-6)
    typical = {"load": load, "direction_load": load, "speed_load": load, "time": 10.0, "direction_time": 10.0}
    typical |= {"error": 0.05, "error_angle": 0.05, "error_drag": 0.05**2, "motor_bump": load}
    typical |= dict.fromkeys(EDGED, DEEP)
    return [typical.get(name.partition("_at_")[0], 1.0) for name in names]


def chosen_terms(problem: Problem, fit: Fit, residuals: Float[np.ndarray, "F R"], most: int = MOST_TERMS) -> list[int]:
    """Terms by orthogonal matching pursuit, as many as predict motions best that neither the choice nor the coefficients saw.

    Args:
        problem: whose seed deals the motions into folds.
        fit: the model without the terms.
        residuals: without any term [rad], and with a little of each.
        most: how many terms may be chosen.
    """
    changes, residual = (residuals[1:] - residuals[0]).T, residuals[0]
    owner = np.asarray(fit.objective.owner)
    fold = folds(problem, len(fit.objective.windows))[owner]
    errors = np.zeros(most + 1)
    for one in range(fold.max() + 1):
        seen, unseen = fold != one, fold == one
        order = _pursue(fit.jacobian[seen], changes[seen], residual[seen], most)
        for count in range(most + 1):
            used = order[:count]
            columns = np.hstack([fit.jacobian, changes[:, used]])
            solved = np.linalg.lstsq(columns[seen], -residual[seen], rcond=1e-6)[0]
            errors[count] += float(np.sum((residual[unseen] + columns[unseen] @ solved) ** 2))
    return _pursue(fit.jacobian, changes, residual, most)[: int(np.argmin(errors))]


def _pursue(
    jacobian: Float[np.ndarray, "R P"], changes: Float[np.ndarray, "R F"], residual: Float[np.ndarray, "R"], most: int
) -> list[int]:
    """Orthogonal matching pursuit over the terms' responses, what the nuisance numbers can do taken out; best term first."""
    projection = Projection(jacobian)
    responses, target = projection.out(changes), projection.out(residual)
    total = float(target @ target)
    sizes = np.linalg.norm(responses, axis=0)
    usable = sizes > 1e-9 * np.sqrt(len(target))
    chosen: list[int] = []
    left = target
    for _ in range(most):
        match = np.where(usable, np.abs(left @ responses) / np.maximum(sizes, 1e-30), 0.0)
        match[chosen] = 0.0
        best = int(np.argmax(match))
        columns = responses[:, [*chosen, best]]
        remaining = target - columns @ np.linalg.lstsq(columns, target, rcond=1e-6)[0]
        if float(left @ left - remaining @ remaining) < SMALLEST_GAIN * total:
            break
        chosen.append(best)
        left = remaining
    return chosen


def _formula(fit: Fit, placement: Placement) -> str:
    """The torque in words and numbers [N m]: q angle, v speed, u command, motor its torque; dof numbers for other joints."""
    values = fit.space.mapping(fit.values)
    found = {
        one.name.partition(".")[2].partition("[")[0]: values[one.name]
        for one in placement.parameters(fit.objective.simulated.robot.model)
    }
    terms = [f"{found[term]:+.3g} {_words(term, found)}" for term in _torque(placement).terms]
    return "tau = " + " ".join(terms) + " N m"


def _words(quantity: str, shape: Mapping[str, float]) -> str:
    plain = {
        "constant": "1", "angle": "q", "speed": "v", "speed_size": "|v|", "drag": "v|v|", "direction": "sign(v)",
        "direction_angle": "sign(v) q", "load": "load", "direction_load": "sign(v) |load|", "speed_load": "v |load|",
        "error": "(u - q)", "error_drag": "(u - q)|u - q|", "error_angle": "(u - q) q", "time": "t", "direction_time": "sign(v) t",
    }  # fmt: skip
    if quantity in plain:
        return plain[quantity]
    kind, _, rest = quantity.partition("_at_")
    if kind.endswith("bump"):
        bump = f"bump(q at {shape['centre_' + rest]:.2f} rad, width {shape['width_' + rest]:.2f})"
        before = {"direction_bump": "sign(v) ", "speed_bump": "v ", "motor_bump": "motor "}.get(kind, "")
        return f"{before}{bump}"
    if kind in EDGED:
        place = shape["edge_" + rest]
        beyond = f"max(q - {place:.3g}, 0)" if kind.endswith("over") else f"max({place:.3g} - q, 0)"
        return {"speed": "v ", "direction": "sign(v) "}.get(kind.partition("_")[0], "") + beyond
    if kind in WAVES:
        return f"{'sin' if kind == 'sine' else 'cos'}(2 pi {shape['frequency_' + rest]:.3g} Hz t)"
    if kind.endswith("recent"):
        lately = f"mean |v| of the last {rest} s"
        return f"sign(v) {lately}" if kind == "direction_recent" else f"v {lately}"
    words = {"other_angle": "q", "direction_other": "sign(v) q", "other_speed": "v", "speed_product": "v v"}
    return f"v |v{rest}|" if kind == "speed_other" else f"{words[kind]}{rest}"
