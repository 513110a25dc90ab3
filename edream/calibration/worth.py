"""What a fit is worth: intervals that know how long errors last, and which parameters the data do not tell apart."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float
from scipy.stats import t as student

from edream.core.parameters import ParameterSpace
from edream.sim.least_squares import autocorrelation_time
from edream.sim.objective import Objective

Status = Literal["converged", "at_bound", "not_identifiable"]
BOX = 1.0 / np.sqrt(12.0)  # standard deviation of a parameter of which nothing is known but its box
VAGUE = 0.13  # of the box; a 95 % interval that covers half of it says nothing
SHARE = 0.3  # of the largest component; a smaller one does not belong to a confounded direction
NEAR_BOUND = 2e-3
BLOCKS = 24
TORQUE_LIKE = ("N m", "N m/rad", "N m s/rad", "kg m^2", "N", "N/m", "N s/m", "kg")


@dataclass(frozen=True)
class Estimate:
    """One parameter as found.

    Attributes:
        value, unit: the number and its unit.
        interval: 95 % interval, cut at the bounds.
        status: whether it can be believed.
        confounded_with: parameters that can move along with it without the data noticing.
        low, high, start: the box and where the search began.
    """

    value: float
    unit: str
    interval: tuple[float, float]
    status: Status
    confounded_with: tuple[str, ...]
    low: float
    high: float
    start: float


@dataclass(frozen=True)
class Direction:
    """A direction in which the data leave the parameters open.

    Attributes:
        shares: parameter -> its component; the largest is 1.
        sentence: what that means.
    """

    shares: dict[str, float]
    sentence: str


@dataclass(frozen=True, eq=False)
class Worth:
    """Estimates of all parameters, their correlation (P, P), the directions that stay open, and the errors' lasting time [rows]."""

    estimates: dict[str, Estimate]
    correlation: Float[np.ndarray, "P P"]
    directions: tuple[Direction, ...]
    lasting: float


def worth_of(
    objective: Objective, values: Float[np.ndarray, "P"], residual: Float[np.ndarray, "R"], slope: Float[np.ndarray, "R P"]
) -> Worth:
    """Intervals and statuses from the residuals and their Jacobian at the fit.

        classical  C0 = (J'J / (s^2 tau) + L)^-1        L: priors, tau: integrated autocorrelation time of the residuals
        sandwich   C1 = H^-1 (sum_b g_b g_b') H^-1      g_b = J_b' r_b over blocks longer than the errors last

    The wider of the two is reported, with Student's t over the number of blocks.

    Source: White, Econometrica 48, 1980; Newey and West, Econometrica 55, 1987; Sokal 1997 for tau.
    """
    space = objective.simulated.space
    unit = space.to_unit(values)
    rows, count = slope.shape
    parts = objective.per_window(residual)
    lasting = autocorrelation_time(parts)
    noise = float(residual @ residual) / max(1, rows - count) * lasting
    if noise <= 0.0:
        noise = 1e-24
    information = slope.T @ slope / noise
    _, spread = space.unit_prior()
    prior = np.diag(1.0 / spread**2)
    classical = np.linalg.inv(information + prior)
    scores = _block_scores(parts, residual, slope, lasting)
    blocks = len(scores)
    meat = scores.T @ scores / noise**2 * (blocks / max(1, blocks - 1))
    sandwich = classical @ meat @ classical
    deviation = np.sqrt(np.maximum(np.diag(classical), np.diag(sandwich)))
    reach = deviation * float(student.ppf(0.975, max(2, blocks - 1)))
    data_only = np.linalg.inv(information + np.eye(count) / BOX**2)
    directions = _open_directions(space, unit, information)
    estimates = _estimates(space, values, unit, reach, np.sqrt(np.diag(data_only)), directions)
    scale = np.sqrt(np.diag(classical))
    return Worth(estimates, classical / scale[:, None] / scale[None, :], directions, lasting)


def _block_scores(parts: Sequence[np.ndarray], residual: np.ndarray, slope: np.ndarray, lasting: float) -> np.ndarray:
    """Gradient of the loss summed over each block: a window where there are enough, else stretches longer than errors last."""
    total = sum(len(part) for part in parts)
    longest = max(len(part) for part in parts)
    length = longest if len(parts) >= BLOCKS else max(int(np.ceil(3 * lasting)), total // BLOCKS, 1)
    scores, at = [], 0
    for part in parts:
        pieces = max(1, round(len(part) / length))
        for rows in np.array_split(np.arange(len(part)), pieces):
            index = slice(at + rows[0] * part.shape[1], at + (rows[-1] + 1) * part.shape[1])
            scores.append(slope[index].T @ residual[index])
        at += part.size
    return np.array(scores)


def _estimates(
    space: ParameterSpace,
    values: np.ndarray,
    unit: np.ndarray,
    reach: np.ndarray,
    data_only: np.ndarray,
    directions: Sequence[Direction],
) -> dict[str, Estimate]:
    low, high = space.from_unit(np.clip(unit - reach, 0.0, 1.0)), space.from_unit(np.clip(unit + reach, 0.0, 1.0))
    estimates = {}
    for i, parameter in enumerate(space.parameters):
        status: Status = "converged"
        if data_only[i] > VAGUE:
            status = "not_identifiable"
        elif not NEAR_BOUND < unit[i] < 1.0 - NEAR_BOUND:
            status = "at_bound"
        others = {name for d in directions if parameter.name in d.shares for name in d.shares} - {parameter.name}
        estimates[parameter.name] = Estimate(
            float(values[i]),
            parameter.unit,
            (float(low[i]), float(high[i])),
            status,
            tuple(name for name in space.names if name in others) if status == "not_identifiable" else (),
            parameter.low,
            parameter.high,
            parameter.start,
        )
    return estimates


def _open_directions(space: ParameterSpace, unit: np.ndarray, information: np.ndarray) -> tuple[Direction, ...]:
    strength, vectors = np.linalg.eigh(information)
    found = []
    for value, vector in zip(strength, vectors.T, strict=True):
        if 1.0 / np.sqrt(max(value, 1e-30) + 1.0 / BOX**2) <= VAGUE:
            continue
        vector = vector / vector[np.argmax(np.abs(vector))]
        shares = {name: round(float(v), 3) for name, v in zip(space.names, vector, strict=True) if abs(v) >= SHARE}
        found.append(Direction(shares, _sentence(space, unit, vector, shares)))
    return tuple(found)


def _sentence(space: ParameterSpace, unit: np.ndarray, vector: np.ndarray, shares: dict[str, float]) -> str:
    names = list(shares)
    if len(names) == 1:
        return f"The data hardly depend on {names[0]}; it stays near its prior."
    nudged = space.from_unit(np.clip(unit + 1e-4 * vector, 0.0, 1.0))
    here = space.from_unit(unit)
    relative = np.array(
        [(n - h) / max(abs(h), 1e-12) for n, h, name in zip(nudged, here, space.names, strict=True) if name in shares]
    )
    alike = [p.unit for p in space.parameters if p.name in shares]
    if all(u in TORQUE_LIKE for u in alike) and np.ptp(relative) < 0.5 * abs(relative.mean()):
        listed = ", ".join(names)
        return f"Positions alone tell only the ratios of {listed}; their common scale is not identifiable and stays near its prior."
    return f"The data tell only a combination of {', '.join(names)}, not each; where along it they lie is up to their priors."
