"""Gauss-Newton in the true simulator."""

from dataclasses import replace

from edream.calibration.polish import polish
from edream.calibration.problem import FitResult, Fitter, Problem
from edream.sim.least_squares import solve

SHARE = 6  # one in so many windows is enough to come near


class GaussNewton(Fitter):
    """Bounded least squares; one batch of simulations gives a whole Jacobian.

    It comes near on every sixth window and finishes on all.
    Source: Branch, Coleman, Li, SIAM J. Sci. Comput. 21, 1999 (trust region reflective), as in scipy.
    """

    name = "gauss_newton"
    summary = "bounded least squares in the true simulator, every column of a Jacobian simulated at once"

    def fit(self, problem: Problem) -> FitResult:
        objective, options = problem.objective, problem.options
        before, start, near_simulations, history = objective.simulations, None, 0, []
        if len(objective.windows) >= 2 * SHARE:
            few = replace(objective, windows=objective.windows[::SHARE], simulations=0)
            near = polish(few, None, options.iterations)
            start, near_simulations = near.values, few.simulations
            history.append(near.start_rms**2)
            # its errors are those that will be left, so they weigh the priors rightly at once
            solution = solve(objective, start, iterations=options.polish)
        else:
            solution = polish(objective, None, options.iterations)
        cost = float(problem.cost(problem.space.to_unit(solution.values))[0])
        simulations = objective.simulations - before + near_simulations
        return FitResult(solution.values, cost, (*history, solution.start_rms**2, cost), simulations, solution.converged)


ENTRY = GaussNewton()
