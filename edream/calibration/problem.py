"""One calibration problem and the interface of what solves it: every fitter minimises the same loss over the same box."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float

from edream.calibration.surrogate import Surrogate
from edream.calibration.windows import Sequences
from edream.core.errors import require
from edream.core.parameters import ParameterSpace
from edream.sim.least_squares import worth
from edream.sim.objective import Objective

Relearn = Callable[[Float[np.ndarray, "N P"]], tuple[Surrogate, int]]
"""Simulates more parameter sets of the unit box and learns from them too; returns the surrogate and how many windows that took."""


@dataclass(frozen=True)
class FitterOptions:
    """How long fitters may search.

    Attributes:
        iterations: most Gauss-Newton steps.
        polish: most Gauss-Newton steps on all windows, after coming near on few or through the surrogate.
        annealing_steps: steps of simulated annealing (SimplerEnv: 400).
        evaluations: most parameter sets that CMA-ES simulates.
        descent_steps: Adam steps through the surrogate, each round.
        rounds: how often the surrogate is learned again around its optimum.
    """

    iterations: int = 12
    polish: int = 10
    annealing_steps: int = 400
    evaluations: int = 600
    descent_steps: int = 80
    rounds: int = 1

    def __post_init__(self) -> None:
        for name in ("iterations", "polish", "annealing_steps", "evaluations", "descent_steps"):
            require(getattr(self, name) > 0, f"fit.search.{name}", getattr(self, name), "1 or more")
        require(self.rounds >= 0, "fit.search.rounds", self.rounds, "0 or more")


@dataclass(eq=False)
class Problem:
    """What is to be fitted.

    Attributes:
        objective: residuals of the true simulator on the training motions; it counts its simulations.
        measured: short windows of the training motions, as recorded, for the surrogate.
        options: how long to search.
        seed: of every random choice.
        joints: which joints count, or None for all.
        surrogate: a learned surrogate, where the fitter needs one.
        relearn: simulates more for the surrogate.
    """

    objective: Objective
    measured: Sequences | None = None
    options: FitterOptions = field(default_factory=FitterOptions)
    seed: int = 0
    joints: Bool[np.ndarray, "J"] | None = None
    surrogate: Surrogate | None = None
    relearn: Relearn | None = None

    @property
    def space(self) -> ParameterSpace:
        return self.objective.simulated.space

    @cached_property
    def noise(self) -> float:
        """What one residual row is worth [rad], which weighs the priors: a fifth of that at the start, where fits tend to end."""
        return 0.2 * worth(self.objective, self.objective.residuals(self.space.start())[0])

    @property
    def prior(self) -> tuple[Float[np.ndarray, "P"], Float[np.ndarray, "P"]]:
        """Centre in the unit box, and weight of a squared distance from it, in the units of the loss."""
        centre, spread = self.space.unit_prior()
        return centre, (self.noise / spread) ** 2 / sum(m.size for m in self.objective.measured)

    def cost(self, unit: Float[np.ndarray, "N P"]) -> Float[np.ndarray, "N"]:
        """Mean squared residual plus the priors' share, of points of the unit box; the one loss of all fitters."""
        unit = np.atleast_2d(unit)
        return self.cost_of(unit, self.objective.residuals(self.space.from_unit(unit)))

    def cost_of(self, unit: Float[np.ndarray, "N P"], residuals: Float[np.ndarray, "N R"]) -> Float[np.ndarray, "N"]:
        """The same of points whose residuals are known."""
        centre, weight = self.prior
        return np.mean(np.square(residuals), axis=-1) + (weight * (np.asarray(unit) - centre) ** 2).sum(axis=-1)


@dataclass(frozen=True, eq=False)
class FitResult:
    """Where a fitter ended.

    Attributes:
        values: the parameters in their units, (P,).
        cost: the loss there.
        history: best loss so far, as the search went on.
        simulations: windows that were simulated.
        converged: whether the search met a tolerance rather than its limit.
        facts: what the fitter has to say about itself, such as the surrogate's error; JSON values.
    """

    values: Float[np.ndarray, "P"]
    cost: float
    history: tuple[float, ...]
    simulations: int
    converged: bool
    facts: dict[str, object] = field(default_factory=dict)


class Fitter(ABC):
    """One way to fit parameters. A new one is one new file in `edream/fitters/` that defines `ENTRY`.

    Attributes:
        name: the word used in configs and reports.
        summary: what it does, in a few words.
        needs_surrogate: whether a sweep and a surrogate have to be made first.
        least_squares: whether it ends in a least-squares solution, which the exact Jacobian of the judgement may still improve.
    """

    name: str
    summary: str
    needs_surrogate: bool = False
    least_squares: bool = False

    @abstractmethod
    def fit(self, problem: Problem) -> FitResult:
        """Search the whole box for the values with the least loss."""
