"""Gauss-Newton in the true simulator."""

from edream.calibration.problem import FitResult, Fitter, Problem
from edream.sim.beginning import beginning
from edream.sim.polish import polish_in_stages


class GaussNewton(Fitter):
    """Bounded least squares; one batch of simulations gives a whole Jacobian.

    It comes near on short pieces of some windows and finishes on all.
    Source: Branch, Coleman, Li, SIAM J. Sci. Comput. 21, 1999 (trust region reflective), as in scipy.
    """

    name = "gauss_newton"
    summary = "bounded least squares in the true simulator, every column of a Jacobian simulated at once"
    least_squares = True

    def fit(self, problem: Problem) -> FitResult:
        before = problem.objective.simulations
        start = beginning(problem.objective)
        solution, near = polish_in_stages(problem.objective, start, problem.options.iterations, problem.options.polish)
        cost = float(problem.cost_of(problem.space.to_unit(solution.values), solution.residual))
        simulations = problem.objective.simulations - before + near
        return FitResult(solution.values, cost, (solution.start_rms**2, cost), simulations, solution.converged)


ENTRY = GaussNewton()
