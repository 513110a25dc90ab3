"""Warm-started refits that reuse a Jacobian: cheap enough to try every serious candidate with all nuisance numbers free."""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import lsq_linear

from edream.core.parameters import ParameterSpace
from edream.diagnosis.intervals import SURE, within_box
from edream.sim.differences import blocks, inwards, jacobian, jacobian_along_axes, nearly, straight
from edream.sim.least_squares import worth
from edream.sim.objective import Objective, rms
from edream.sim.polish import coupled
from edream.sim.window import Window

STRETCH = 1.5  # s
LONGEST_STEP = 0.2  # of the unit box
SHORTER = (0.5, 0.2, 0.06)  # of a step
LITTLE = 0.1  # of a squared standard deviation: a gain that no interval would notice
MOST_TURNS, SETTLED = 7, 0.8  # differences at an end; of each curvature, the share from which it is no flatter than it seemed
PATIENT = 3  # iterations from which a descent is meant to arrive
WORD = 0.5  # share of the promised gain that a whole step must bring
PULLING = 0.02  # share of what numbers do that is on other joints than their own, from which it is differenced anew as well


@dataclass(frozen=True, eq=False)
class Fit:
    """A fitted model.

    Attributes:
        objective: the model and the windows it was fitted to.
        unit: its parameters in the unit box, (P,).
        residual: there [rad], (R,).
        jacobian: d residual / d unit, (R, P).
        scale: the noise [rad] that one residual row is worth, which weighs the priors.
        ended: whether it was gone down to the end, as `polish` does, where intervals are true.
        pulling: whether links pull at each other so much that what a number does to other joints counts on the way down.
    """

    objective: Objective
    unit: Float[np.ndarray, "P"]
    residual: Float[np.ndarray, "R"]
    jacobian: Float[np.ndarray, "R P"]
    scale: float
    ended: bool = False
    pulling: bool = False

    @property
    def space(self) -> ParameterSpace:
        return self.objective.simulated.space

    @property
    def values(self) -> Float[np.ndarray, "P"]:
        return self.space.from_unit(self.unit)

    @property
    def rms(self) -> float:
        return rms(self.residual)

    def hessian(self) -> Float[np.ndarray, "P P"]:
        """Of half the cost in the unit box, with its priors."""
        return self.jacobian.T @ self.jacobian / self.scale**2 + np.diag(self.space.unit_prior()[1] ** -2.0)

    def covariance(self) -> Float[np.ndarray, "P P"]:
        """Covariance of the unit-box parameters, robust to errors that differ between motions and last long within one.

            C = H^-1 (sum_m g_m g_m^T + prior) H^-1, H = J^T J / s^2 + prior, g_m = J_m^T r_m / s^2

        Source: Liang, Zeger, Biometrika 73(1), 1986 (cluster-robust sandwich, clusters = motions), with the factor m / (m - 1);
        the larger of it and H^-1 is taken on the diagonal, since few clusters underestimate.
        """
        _, spread = self.space.unit_prior()
        prior = np.diag(np.where(np.isfinite(spread), spread, np.inf) ** -2.0)
        inverse = np.linalg.pinv(self.hessian(), hermitian=True)
        weighted = self.jacobian * self.residual[:, None] / self.scale**2
        count = int(self.objective.owner[-1]) + 1
        scores = np.stack([weighted[self.objective.owner == m].sum(axis=0) for m in range(count)])
        meat = scores.T @ scores * count / max(count - 1, 1) + prior
        sandwich = inverse @ meat @ inverse
        grow = np.sqrt(np.maximum(np.diag(inverse) / np.maximum(np.diag(sandwich), 1e-300), 1.0))
        return sandwich * grow[:, None] * grow[None, :]

    def intervals(self, level: float = SURE) -> dict[str, tuple[float, float]]:
        """95 % interval of each parameter, in its unit, where no other leaves its box with it (see `within_box`)."""
        low, high = (self.space.from_unit(end) for end in within_box(self.unit, self.covariance(), level))
        return {name: (float(a), float(b)) for name, a, b in zip(self.space.names, low, high, strict=True)}


def step_from(fit: Fit, rows: Bool[np.ndarray, "R"] | None = None, damping: float = 0.0) -> Float[np.ndarray, "P"]:
    """One bounded Gauss-Newton step in the unit box, over all residual rows or some of them."""
    centre, spread = fit.space.unit_prior()
    weight = np.where(np.isfinite(spread), 1.0 / spread, 0.0)
    jac = fit.jacobian if rows is None else fit.jacobian[rows]
    res = fit.residual if rows is None else fit.residual[rows]
    # normal equations through a Cholesky-like square root keep the bounded solve small: P x P instead of R x P
    hessian = jac.T @ jac / fit.scale**2 + np.diag(weight**2 + damping)
    gradient = jac.T @ res / fit.scale**2 + weight**2 * (fit.unit - centre)
    eigen, vectors = np.linalg.eigh(hessian)
    eigen = np.maximum(eigen, 1e-12 * eigen[-1])
    root = np.sqrt(eigen)[:, None] * vectors.T
    target = -(vectors.T @ gradient) / np.sqrt(eigen)
    low = np.maximum(-fit.unit, -LONGEST_STEP) - 1e-12
    high = np.minimum(1.0 - fit.unit, LONGEST_STEP) + 1e-12
    return lsq_linear(root, target, bounds=(low, high), method="bvls").x


def cost(fit: Fit) -> float:
    """Sum of squares of the residual, in units of its worth, and of the distance to the priors."""
    centre, spread = fit.space.unit_prior()
    known = np.isfinite(spread)
    away = ((fit.unit - centre) / spread)[known]
    return float((fit.residual**2).sum() / fit.scale**2 + (away**2).sum())


def begin(objective: Objective, unit: Float[np.ndarray, "P"]) -> Fit:
    """A fit at a starting point, with a fresh Jacobian."""
    space = objective.simulated.space
    residual = objective.residuals(space.from_unit(unit))[0]
    slope = jacobian(objective, space, unit, residual)
    across = (np.where(own_rows(objective, residual), 0.0, slope) ** 2).sum(axis=0) / np.maximum((slope**2).sum(axis=0), 1e-300)
    return Fit(objective, unit, residual, slope, worth(objective, residual), pulling=bool(across.size and across.mean() > PULLING))


def own_rows(objective: Objective, residual: Float[np.ndarray, "R"]) -> Bool[np.ndarray, "R P"]:
    """Which rows of a residual are of joints that a parameter acts on."""
    return np.tile(objective.acts_on.T, (len(residual) // objective.acts_on.shape[1], 1))


def stretches(fit: Fit, seconds: float = STRETCH) -> list[Window]:
    """The fit's motions cut into short stretches that restart at measured states: their errors have few false valleys."""
    return [part for window in fit.objective.windows for part in _cut(window, seconds)]


def _cut(window: Window, seconds: float) -> list[Window]:
    count = max(1, round(float(window.times[-1]) / seconds))
    rows = np.searchsorted(window.times, np.linspace(0.0, window.times[-1], count + 1)) + window.first
    return [Window(window.episode, int(a), int(b)) for a, b in pairwise(rows) if b > a]


def descend(fit: Fit, fresh: Bool[np.ndarray, "P"] | None = None, iterations: int = 6, tolerance: float = 3e-3) -> Fit:
    """Go down until a step gains less than `tolerance` of the cost, or does not even promise as much.

    Each step solves the bounded, prior-weighted linear problem; where the whole step brings less than half of what it promised,
    shorter ones are tried too. Columns in `fresh` are differenced anew after each step, the others follow by Broyden's update.
    Where all are to be fresh, that is done joint by joint, and what a parameter does to other joints follows; but where links pull
    at each other, that is differenced anew, too, since a stale one makes many steps of few.

    Args:
        fit: where to begin.
        fresh: which columns to difference anew, (P,); all where None.
        iterations: most steps.
        tolerance: relative gain below which the fit has arrived.
    """
    doubted = False
    for _ in range(iterations):
        move = step_from(fit)
        before, promised = cost(fit), cost(replace(fit, unit=fit.unit + move, residual=fit.residual + fit.jacobian @ move))
        if before - promised < tolerance * before:
            break
        tried = _tried(fit, np.clip([fit.unit + move], 0.0, 1.0))
        if before - tried[0][0] < WORD * (before - promised):
            tried += _tried(fit, np.clip(fit.unit + np.outer(SHORTER, move), 0.0, 1.0))
        after, unit, residual = min(tried, key=lambda one: one[0])
        if not after < before:
            if doubted or iterations < PATIENT:
                break
            # no step helps: with a Jacobian that was carried along, that says little
            fit, doubted = replace(fit, jacobian=_own_renewed(fit, fit.jacobian), ended=False), True
            continue
        doubted = False
        fit = _moved(fit, unit, residual, fresh)
        if before - after < tolerance * before:
            break
    return fit


def polish(fit: Fit, iterations: int = 3) -> Fit:
    """Go down to the end, also along a valley that is all but flat; for intervals that are stated see `with_true_slopes`.

    Differences go along the principal axes of the last Jacobian, and steps straight in the parameters' own units. What joints do to
    each other comes in when steps without it have come to their end, where it is more than a little.
    """
    groups = blocks(fit.objective.acts_on)
    for apart in (True, False) if len(groups) > 1 else (False,):
        if len(groups) > 1 and not apart and not coupled(fit.objective, groups, fit.unit, fit.residual, fit.hessian()):
            break
        for _ in range(iterations):
            slope = jacobian_along_axes(fit.objective, fit.unit, fit.hessian(), apart)
            fit = replace(fit, jacobian=slope, scale=worth(fit.objective, fit.residual))
            before, move = cost(fit), step_from(fit)
            after, unit, residual = min(
                _tried(fit, straight(fit.space, fit.unit, np.outer((1.0, *SHORTER), move))), key=lambda one: one[0]
            )
            if not after < before:
                break
            fit = replace(fit, unit=unit, residual=residual)
            if before - after < LITTLE:
                break
    return replace(fit, ended=True)


def with_true_slopes(fit: Fit) -> Fit:
    """The fit where it is, differenced along its principal axes until these have settled: there intervals are true.

    A valley that is all but flat seems steep until the differences go along it, and that takes some turns: what the kinks of dry
    friction leave of single numbers' differences had made the interval of a friction a fifth as wide as it is.
    """
    groups = blocks(fit.objective.acts_on)
    apart = len(groups) > 1
    for _ in range(MOST_TURNS):
        seemed = np.linalg.eigvalsh(fit.hessian())
        fit = replace(fit, jacobian=jacobian_along_axes(fit.objective, fit.unit, fit.hessian(), apart))
        if np.all(np.linalg.eigvalsh(fit.hessian()) >= SETTLED * seemed):
            break
    if apart and coupled(fit.objective, groups, fit.unit, fit.residual, fit.hessian()):
        fit = replace(fit, jacobian=jacobian_along_axes(fit.objective, fit.unit, fit.hessian(), apart=False))
    return fit


def _tried(fit: Fit, units: Float[np.ndarray, "N P"]) -> list[tuple[float, np.ndarray, np.ndarray]]:
    """Cost, place and residual at several places."""
    residuals = fit.objective.residuals(fit.space.from_unit(units))
    return [(cost(replace(fit, unit=u, residual=r)), u, r) for u, r in zip(units, residuals, strict=True)]


def _moved(fit: Fit, unit: np.ndarray, residual: np.ndarray, fresh: np.ndarray | None) -> Fit:
    change = unit - fit.unit
    surprise = residual - fit.residual - fit.jacobian @ change
    jac = fit.jacobian + np.outer(surprise, change) / max(float(change @ change), 1e-12)
    if fresh is None:
        jac = _own_renewed(replace(fit, unit=unit, residual=residual), jac)
    elif fresh.any():
        steps = inwards(fit.objective, unit)
        chosen = np.flatnonzero(fresh)
        moved = fit.objective.residuals(fit.space.from_unit(unit + np.diag(steps)[chosen]))
        jac[:, chosen] = ((moved - residual) / steps[chosen, None]).T
    return replace(fit, unit=unit, residual=residual, jacobian=jac, scale=worth(fit.objective, residual), ended=False)


def _own_renewed(fit: Fit, slope: Float[np.ndarray, "R P"]) -> Float[np.ndarray, "R P"]:
    """A Jacobian with what each parameter does to the joints that it acts on differenced anew; what it does to others as it was."""
    if fit.pulling:
        return jacobian(fit.objective, fit.space, fit.unit, fit.residual)
    own = own_rows(fit.objective, fit.residual)
    return np.where(own, nearly(fit.objective, fit.space, fit.unit, fit.residual), slope)
