"""Simpler methods on the same recordings, blindfolded like the diagnosis they are compared with.

Each returns what it can: `named` (an effect at its place, or None) and `after_rad` (error on the motions never fitted).
"""

import math
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks.blind.equation import TorqueNet, fit_nets, fit_sparse
from edream.catalog import load
from edream.core.effect import Effect
from edream.diagnosis.candidates import moving_bodies
from edream.diagnosis.descent import Fit, begin, descend
from edream.diagnosis.never_fitted import proof_errors
from edream.diagnosis.nuisance import published
from edream.diagnosis.problem import Problem, nuisance_placements
from edream.diagnosis.screen import screen
from edream.diagnosis.trials import try_best
from edream.diagnosis.verdict import Diagnosis
from edream.sim.simulation import Placement, SimulatedRobot

PLAIN = ("quadratic_drag", "spring", "constant_torque", "actuator_lag", "torque_limit")  # by joint, all native MJCF


def run_baselines(found: Diagnosis) -> dict[str, dict[str, Any]]:
    """All four, each with its seconds."""
    methods: dict[str, Callable[[Diagnosis], dict[str, Any]]] = {"all_free": all_free, "bic": bic, "sparse": sparse, "mlp": mlp}
    out = {}
    for name, method in methods.items():
        began = time.monotonic()
        out[name] = method(found)
        out[name]["seconds"] = time.monotonic() - began
    return out


def _after(problem: Problem, fit: Fit) -> float:
    return float(np.sqrt(proof_errors(problem, fit).mean()))


def all_free(found: Diagnosis) -> dict[str, Any]:
    """Every parameter that MJCF has, free at once, and no name: what `mujoco.sysid` would be asked to do."""
    problem = found.problem
    extra = [Placement(load("effects", name, Effect), (joint,)) for name in PLAIN for joint in problem.joints]
    extra.append(Placement(load("effects", "gravity_tilt", Effect), ()))
    extra += [Placement(load("effects", "payload", Effect), (body,)) for body in moving_bodies(problem)]
    simulated = SimulatedRobot(problem.robot, (*nuisance_placements(problem), *extra))
    objective = replace(published(problem), simulated=simulated)
    calibrated = found.rounds[0].before  # what is named in its numbers included, which `found.before` is without
    known = calibrated.space.mapping(calibrated.values)
    start = [known.get(p.name, p.start if p.absent is None else p.absent) for p in simulated.space.parameters]
    fit = descend(begin(objective, np.clip(simulated.space.to_unit(np.array(start)), 0.0, 1.0)), None, iterations=6)
    return {"after_rad": _after(problem, fit), "numbers": len(fit.unit)}


def bic(found: Diagnosis) -> dict[str, Any]:
    """Refits with one effect each, ranked by Schwarz's criterion n log(rss / n) + k log n on the motions fitted.

    Source: Schwarz, Annals of Statistics 6(2), 1978.
    """
    problem, first = found.problem, found.rounds[0]
    trials = first.trials or try_best(problem, first.before, first.errors, screen(problem, first.before))

    def criterion(fit: Fit) -> float:
        rows = len(fit.residual)
        return rows * math.log(float(fit.residual @ fit.residual) / rows) + len(fit.unit) * math.log(rows)

    best = min(trials, key=lambda t: criterion(t.fit), default=None)
    if best is None or criterion(best.fit) >= criterion(first.before):
        return {"named": None, "after_rad": _after(problem, first.before)}
    return {"named": best.candidate.label, "after_rad": _after(problem, best.fit)}


def sparse(found: Diagnosis) -> dict[str, Any]:
    """Sequentially thresholded least squares on the equation residual; the feature that explains most is the name."""
    return fit_sparse(found.problem)


def mlp(found: Diagnosis) -> dict[str, Any]:
    """A small network of the state on every joint, fitted to the equation residual and simulated as a torque."""
    problem = found.problem
    nets = fit_nets(problem)
    placements = tuple(Placement(TorqueNet(net), (joint,)) for joint, net in nets.items())
    objective = replace(published(problem), simulated=SimulatedRobot(problem.robot, placements))
    fit = Fit(objective, np.zeros(0), np.zeros(0), np.zeros((0, 0)), 1.0)
    return {"after_rad": _after(problem, fit)}
