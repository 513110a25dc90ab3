"""Gauss-Newton in the true simulator: bounded, with priors, one batch of simulations a Jacobian."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.optimize import least_squares

from edream.core.parameters import ParameterSpace
from edream.sim.differences import jacobian, nearly, sharing
from edream.sim.objective import Objective, rms

REFRESH = 3
NEVER = 10**6
COARSE = 3e-3  # relative step that ends a search with a cheap Jacobian, whose smaller steps lead nowhere


@dataclass(frozen=True, eq=False)
class Solution:
    """Where a least-squares fit ended.

    Attributes:
        space: the parameters.
        values: their values, (P,).
        residual: data residuals there [rad], (R,).
        jacobian: d residual / d unit-box coordinate there, (R, P).
        converged: whether the optimiser met a tolerance rather than its limit.
        start_rms, rms: root-mean-square residual before and after [rad].
    """

    space: ParameterSpace
    values: Float[np.ndarray, "P"]
    residual: Float[np.ndarray, "R"]
    jacobian: Float[np.ndarray, "R P"]
    converged: bool
    start_rms: float
    rms: float


class Slopes:
    """Jacobians along a search: one in `every` is simulated, the others follow from it by Broyden's rank-one update."""

    def __init__(
        self, objective: Objective, space: ParameterSpace, every: int, cheap: bool, first: Float[np.ndarray, "R P"] | None
    ) -> None:
        self._objective, self._space, self._every = objective, space, every
        self._simulated = nearly if cheap else jacobian
        self._first = first
        self._count = 0
        self._last: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None

    def at(self, unit: Float[np.ndarray, "P"], residual: Float[np.ndarray, "R"]) -> Float[np.ndarray, "R P"]:
        """d residual / d unit-box coordinate."""
        if self._last is None and self._first is not None:
            slope = self._first
        elif self._last is None or self._count % self._every == 0:
            slope = self._simulated(self._objective, self._space, unit, residual)
        else:
            there, before, slope = self._last
            step = unit - there
            if np.linalg.norm(step) >= self._objective.step:  # a shorter step sees the kinks of dry friction, not the slope
                slope = slope + np.outer((residual - before - slope @ step) / (step @ step), step)
        self._count += 1
        self._last = (unit.copy(), residual, slope)
        return slope


def solve(
    objective: Objective,
    start: Float[np.ndarray, "P"] | None = None,
    noise: float | None = None,
    iterations: int = 12,
    tolerance: float = 1e-4,
    secant: bool = False,
    cheap: bool = False,
    slope: Float[np.ndarray, "R P"] | None = None,
) -> Solution:
    """Fit every parameter of the objective's robot to its recordings.

        minimise sum_r (r / noise)^2 + sum_p ((u_p - u0_p) / s_p)^2   over the unit box

    Args:
        objective: what to fit.
        start: where to begin, in the parameters' units; the space's start where None.
        noise: standard deviation [rad] that one independent residual row is worth; it sets the weight of the priors.
            Where None, the residual's own root mean square, inflated by its autocorrelation.
        iterations: most Jacobians computed.
        tolerance: relative change of the cost, and of the unit-box step, that ends the fit.
        secant: simulate every third Jacobian only, and bring the last one up to date between, from the residuals that are there.
            Source: Broyden, Mathematics of Computation 19, 1965.
        cheap: simulate `nearly` the Jacobian once, and go on from it by updates alone; without effect where no two parameters can
            share a simulation.
        slope: the Jacobian at the start, where it is known.
    """
    space = objective.simulated.space
    centre, spread = space.unit_prior()
    known = np.isfinite(spread)
    begin = np.clip(space.to_unit(space.start() if start is None else np.asarray(start)), 0.0, 1.0)
    first = objective.residuals(space.from_unit(begin))[0]
    scale = noise if noise is not None else worth(objective, first)
    cache = {begin.tobytes(): first}

    def data(unit: np.ndarray) -> np.ndarray:
        key = unit.tobytes()
        if key not in cache:
            cache[key] = objective.residuals(space.from_unit(unit))[0]
        return cache[key]

    def function(unit: np.ndarray) -> np.ndarray:
        return np.concatenate([data(unit) / scale, ((unit - centre) / spread)[known]])

    cheap = cheap and len(sharing(objective.acts_on)) < len(space)
    slopes = Slopes(objective, space, NEVER if cheap else REFRESH if secant else 1, cheap, slope)

    def derivative(unit: np.ndarray) -> np.ndarray:
        prior = np.diag(1.0 / spread)[known]
        return np.concatenate([slopes.at(unit, data(unit)) / scale, prior])

    if not len(space):
        return Solution(space, np.zeros(0), first, np.zeros((len(first), 0)), True, rms(first), rms(first))
    inside = np.clip(begin, 1e-6, 1.0 - 1e-6)
    found = least_squares(
        function,
        inside,
        derivative,  # pyright: ignore[reportArgumentType] - scipy takes a function here
        bounds=(0.0, 1.0),
        method="trf",
        x_scale=0.1,
        max_nfev=iterations,
        ftol=tolerance,
        xtol=max(tolerance, COARSE) if cheap else tolerance,
        gtol=None,  # pyright: ignore[reportArgumentType]
    )
    residual = data(found.x)
    there = found.jac[: len(residual)] * scale
    return Solution(space, space.from_unit(found.x), residual, there, found.status > 0, rms(first), rms(residual))


def worth(objective: Objective, residual: Float[np.ndarray, "R"]) -> float:
    """The noise [rad] that one residual row stands for, given how long its errors last.

    Rows of one motion are not independent: with an integrated autocorrelation time of tau rows, n rows tell as much as n / tau.
    """
    return rms(residual) * float(np.sqrt(autocorrelation_time(objective.per_window(residual))))


def autocorrelation_time(parts: list[Float[np.ndarray, "T J"]]) -> float:
    """Integrated autocorrelation time [rows], tau = 1 + 2 sum rho_k up to the first k with rho_k below 0.05.

    Source: Sokal, Monte Carlo Methods in Statistical Mechanics, 1997; Geyer's initial positive sequence.
    """
    longest = max(len(part) for part in parts)
    size = 2 ** int(np.ceil(np.log2(2 * longest)))
    power = sum((np.abs(np.fft.rfft(part, size, axis=0)) ** 2).sum(axis=1) for part in parts)
    covariance = np.fft.irfft(power, size)[:longest]
    if covariance[0] <= 0.0:
        return 1.0
    rho = covariance / covariance[0]
    below = np.flatnonzero(rho < 0.05)
    return float(max(1.0, 1.0 + 2.0 * rho[1 : below[0] if len(below) else longest].sum()))
