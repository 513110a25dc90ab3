"""CMA-ES: a population that learns the shape of the valley it is in."""

import cma
import numpy as np

from edream.calibration.problem import FitResult, Fitter, Problem


class CmaEs(Fitter):
    """Covariance matrix adaptation evolution strategy; each generation is one batch of simulations.

    Source: Hansen, The CMA Evolution Strategy: A Tutorial, 2016; package `cma`.
    """

    name = "cmaes"
    summary = "CMA-ES, one generation a batch"

    def fit(self, problem: Problem) -> FitResult:
        before = problem.objective.simulations
        space = problem.space
        start = np.clip(space.to_unit(space.start()), 0.01, 0.99)
        options = {"bounds": [0.0, 1.0], "seed": problem.seed % 2**31 + 1, "verbose": -9, "tolfun": 1e-12, "tolx": 1e-5}
        search = cma.CMAEvolutionStrategy(start, 0.2, options | {"maxfevals": problem.options.evaluations})
        history = [float(problem.cost(start)[0])]
        best, least = start, history[0]
        while not search.stop():
            points = np.array(search.ask())
            costs = problem.cost(points)
            search.tell(list(points), [float(c) for c in costs])
            if costs.min() < least:
                best, least = points[costs.argmin()], float(costs.min())
            history.append(least)
        converged = "maxfevals" not in dict(search.stop() or {})
        return FitResult(space.from_unit(best), least, tuple(history), problem.objective.simulations - before, converged)


ENTRY = CmaEs()
