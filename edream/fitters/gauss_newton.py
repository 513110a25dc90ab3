"""Gauss-Newton in the true simulator."""

from edream.calibration.problem import FitResult, Fitter, Problem
from edream.sim.least_squares import solve


class GaussNewton(Fitter):
    """Bounded least squares; one batch of simulations gives a whole Jacobian.

    Source: Branch, Coleman, Li, SIAM J. Sci. Comput. 21, 1999 (trust region reflective), as in scipy.
    """

    name = "gauss_newton"
    summary = "bounded least squares in the true simulator, every column of a Jacobian simulated at once"

    def fit(self, problem: Problem) -> FitResult:
        before = problem.objective.simulations
        solution = solve(problem.objective, noise=problem.noise, iterations=problem.options.iterations)
        cost = float(problem.cost(problem.space.to_unit(solution.values))[0])
        history = (solution.start_rms**2, cost)
        return FitResult(solution.values, cost, history, problem.objective.simulations - before, solution.converged)


ENTRY = GaussNewton()
