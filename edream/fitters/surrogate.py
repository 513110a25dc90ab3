"""The paper's way: gradient descent through a learned copy of the simulator, then confirmed by the simulator itself."""

import numpy as np

from edream.calibration.descent import descend
from edream.calibration.problem import FitResult, Fitter, Problem
from edream.core.errors import EdreamError
from edream.sim.polish import polish_in_stages

STARTS = 4  # random starts of the descent; they run as one batch
AROUND = 0.12  # of the box: where parameter sets are drawn for learning again
MORE_SETS = 32


class SurrogateFit(Fitter):
    """Adam on the parameters, through the frozen surrogate, over many short windows of the recordings.

        theta* = argmin_theta sum_t |M(a_t, S_t; theta) - S_t|^2

    Then parameter sets are drawn around the optimum and simulated, the surrogate learns from them too, and descends again.
    The true simulator confirms: the best of the start and the optima goes through a few Gauss-Newton steps.
    """

    name = "surrogate"
    summary = "gradient descent through the surrogate, confirmed and polished in the true simulator"
    needs_surrogate = True
    least_squares = True

    def fit(self, problem: Problem) -> FitResult:
        if problem.surrogate is None or problem.measured is None:
            raise EdreamError("fit.method=surrogate needs a learned surrogate; run it through 'edream calibrate'.")
        before = problem.objective.simulations
        space, surrogate = problem.space, problem.surrogate
        rng = np.random.default_rng(problem.seed)
        start = np.clip(space.to_unit(space.start()), 0.02, 0.98)
        candidates, facts = [start], {}
        extra = 0
        for round_number in range(problem.options.rounds + 1):
            begin = np.concatenate([np.array(candidates), rng.uniform(0.05, 0.95, (STARTS - len(candidates), len(space)))])
            found, losses = descend(
                surrogate, problem.measured, begin, problem.prior, problem.options.descent_steps, problem.joints
            )
            candidates.append(found[int(np.argmin(losses))])
            facts[f"descent {round_number}"] = {
                "surrogate_rms_rad": float(np.sqrt(losses.min())),
                "disagreement_rad": float(surrogate.trust(candidates[-1][None], problem.measured)[0]),
            }
            if round_number < problem.options.rounds and problem.relearn is not None:
                around = np.clip(candidates[-1] + rng.normal(0.0, AROUND, (MORE_SETS, len(space))), 0.0, 1.0)
                surrogate, simulated = problem.relearn(around)
                extra += simulated
        costs = problem.cost(np.array(candidates))
        best = candidates[int(np.argmin(costs))]
        options = problem.options
        polished, near = polish_in_stages(problem.objective, space.from_unit(best), options.iterations, options.polish)
        cost = float(problem.cost_of(space.to_unit(polished.values), polished.residual))
        facts["confirmed"] = [float(c) for c in costs]
        simulations = problem.objective.simulations - before + extra + near
        return FitResult(polished.values, cost, (*(float(c) for c in costs), cost), simulations, polished.converged, facts)


ENTRY = SurrogateFit()
