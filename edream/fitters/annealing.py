"""Simulated annealing, as SimplerEnv calibrates its robots."""

import numpy as np

from edream.calibration.problem import FitResult, Fitter, Problem

HOTTEST = 0.5  # of the loss at the start


class Annealing(Fitter):
    """Random steps through the box; a worse point is taken with probability exp(-(E' - E) / T), T falling to 0 in a straight line.

    Each step moves every parameter by up to half the box, damped as it cools. One simulation of all motions a step.
    Source: Li et al., SimplerEnv, 2024 (tools/sysid): 400 steps in the paper's comparison.
    """

    name = "annealing"
    summary = "SimplerEnv's simulated annealing, one set of numbers at a time"

    def fit(self, problem: Problem) -> FitResult:
        before = problem.objective.simulations
        rng = np.random.default_rng(problem.seed)
        space, steps = problem.space, problem.options.annealing_steps
        here = np.clip(space.to_unit(space.start()), 0.0, 1.0)
        energy = float(problem.cost(here)[0])
        best, least, start = here, energy, energy
        history = [energy]
        for step in range(steps):
            heat = 1.0 - (step + 1) / steps
            move = rng.uniform(-0.5, 0.5, len(space)) * max(heat, 0.02)
            tried = np.clip(here + move, 0.0, 1.0)
            found = float(problem.cost(tried)[0])
            chance = rng.uniform()
            if found <= energy or chance < np.exp(-(found - energy) / max(1e-30, HOTTEST * start * heat)):
                here, energy = tried, found
            if found < least:
                best, least = tried, found
            history.append(least)
        return FitResult(space.from_unit(best), least, tuple(history), problem.objective.simulations - before, False)


ENTRY = Annealing()
