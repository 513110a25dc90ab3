"""The first fit: what every real robot has, found before anything is called missing."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.stats import qmc

from edream.diagnosis.descent import Fit, begin, descend
from edream.diagnosis.problem import CREDIBLE_FACTOR, Problem, nuisance_placements
from edream.sim.least_squares import worth
from edream.sim.objective import Objective, rms
from edream.sim.rollout import Window
from edream.sim.simulation import SimulatedRobot

STARTS = 128
DESCENTS_TIMES_NUMBERS = 60
FAR = 20.0  # floors of error from which a valley with incredible numbers may be the wrong one
REACH = 0.5  # of the unit box, on either side of the first fit


def published(problem: Problem) -> Objective:
    """The published model as it stands, on the fitted motions."""
    return Objective(
        SimulatedRobot(problem.robot, ()), problem.fitted, problem.counted, problem.settings.stride, problem.settings.threads
    )


def fit_nuisance(problem: Problem) -> Fit:
    """Gain, damping, dry friction and inertia of every group of joints, first without priors, then with those that are credible."""
    bare = SimulatedRobot(problem.robot, nuisance_placements(problem))
    objective = replace(published(problem), simulated=bare)
    first = descend(begin(objective, bare.space.to_unit(bare.space.start())), None, iterations=8, tolerance=0.01)
    if first.rms > FAR * problem.floor and not credible(first):
        first = search_wide(first, problem.settings.seed)
    believed = SimulatedRobot(problem.robot, nuisance_placements(problem, bare.space.mapping(first.values)))
    again = replace(objective, simulated=believed, simulations=0)
    unit = believed.space.to_unit(first.values)
    started = Fit(again, unit, first.residual, _rescaled(first, believed), worth(again, first.residual))
    return descend(started, None, iterations=4, tolerance=0.003)


def _rescaled(fit: Fit, believed: SimulatedRobot) -> np.ndarray:
    """The Jacobian for a space with the same parameters and the same boxes; only priors differ."""
    if believed.space.names != fit.space.names:
        raise ValueError("the spaces differ in more than their priors")
    return fit.jacobian


def credible(fit: Fit) -> bool:
    """Whether every fitted number lies within a factor of 2.5 of the published one (those published as 0 aside)."""
    start = fit.space.start()
    known = start > 0.0
    ratio = fit.values[known] / start[known]
    return bool(np.all((ratio > 1.0 / CREDIBLE_FACTOR) & (ratio < CREDIBLE_FACTOR)))


def search_wide(fit: Fit, seed: int) -> Fit:
    """Look for a better valley where the published numbers are far off: Sobol points around the first fit, the best ones descended."""
    few = replace(fit.objective, windows=brief(fit.objective.windows), simulations=0)
    centre = fit.unit
    cloud = qmc.Sobol(len(centre), rng=np.random.default_rng([seed, 17])).random(STARTS)
    low, high = np.clip(centre - REACH, 0.0, 1.0), np.clip(centre + REACH, 0.0, 1.0)
    points = np.vstack([centre, low + cloud * (high - low)])
    errors = [rms(one) for one in few.residuals(fit.space.from_unit(points))]
    count = int(np.clip(DESCENTS_TIMES_NUMBERS // len(centre), 2, 12))
    best = [descend(begin(few, points[i]), None, iterations=8, tolerance=0.01) for i in np.argsort(errors)[:count]]
    valley = min(best, key=lambda one: one.rms)
    return min(fit, descend(begin(fit.objective, valley.unit), None, iterations=4, tolerance=0.01), key=lambda one: one.rms)


def brief(windows: Sequence[Window]) -> list[Window]:
    """At most eight of the windows, evenly chosen, each cut to its first ten seconds."""
    chosen = [windows[i] for i in np.unique(np.linspace(0, len(windows) - 1, min(8, len(windows))).round().astype(int))]
    return [replace(w, last=min(w.last, w.first + max(20, int(np.searchsorted(w.times, 10.0)) - 1))) for w in chosen]
