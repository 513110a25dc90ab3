"""The first fit: what every real robot has, found before anything is called missing."""

from dataclasses import replace

import numpy as np

from edream.diagnosis.descent import Fit, begin, descend
from edream.diagnosis.problem import Problem, nuisance_placements
from edream.sim.least_squares import worth
from edream.sim.objective import Objective
from edream.sim.simulation import SimulatedRobot


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
