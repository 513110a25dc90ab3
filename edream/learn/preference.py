"""What it means to learn from trials that went better or worse: one objective per file in `edream/preferences/`."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Literal

from jaxtyping import Bool, Float, Int
from torch import Tensor

from edream.core.errors import require

LooksAt = Literal["pairs", "starts", "decisions"]


@dataclass(frozen=True)
class PreferenceOptions:
    """What the objectives read.

    Attributes:
        beta: how sharply a difference of log-ratios counts.
        alpha: weight of the chosen trajectory's own error; 0 is the paper's form of TPO.
        clip: how far a ratio may move before it stops to count (grpo).
        step: how far the mean is to go the way that chance led a trial that did one spread better than others of its start, as a
            share of that way (natural).
    """

    beta: float = 0.005
    alpha: float = 1.0
    clip: float = 0.2
    step: float = 1.4

    def __post_init__(self) -> None:
        require(self.beta > 0, "rl.objective.beta", self.beta, "a number above 0")
        require(self.alpha >= 0, "rl.objective.alpha", self.alpha, "0 or more")
        require(self.clip > 0, "rl.objective.clip", self.clip, "a number above 0")
        require(self.step > 0, "rl.objective.step", self.step, "a number above 0")


@dataclass(frozen=True, eq=False)
class Judged:
    """N trajectories, or N single decisions of trajectories, under the policy that learns.

    Attributes:
        ratio: log-likelihood of what was executed less that under the reference, summed over steps and actuators, (N,).
        error: sum of |a - mu| / b over the same, (N,).
        size: how many numbers were summed, (N,).
        chosen, rejected: rows of each pair, (P,).
        advantage: how much better than the other trials of its start each, or its trial, was, in their spreads, (N,).
        good: whether a trajectory is one to imitate, (N,).
        chance: sum of |a - mu_ref| / b over the same, (N,): how far chance, or clipping, led what was executed from what was meant.
        moved: sum of ((mu - mu_ref) / b)^2, (N,).
        towards: sum of (mu - mu_ref) (a - mu_ref) / b^2, (N,): how far that goes the way that chance led.
    """

    ratio: Float[Tensor, "N"]
    error: Float[Tensor, "N"]
    size: Float[Tensor, "N"]
    chosen: Int[Tensor, "P"]
    rejected: Int[Tensor, "P"]
    advantage: Float[Tensor, "N"]
    good: Bool[Tensor, "N"]
    chance: Float[Tensor, "N"]
    moved: Float[Tensor, "N"]
    towards: Float[Tensor, "N"]


class Preference(ABC):
    """One way to learn from trials. A new one is one new file in `edream/preferences/` that defines `ENTRY`.

    Attributes:
        looks_at: what a batch is made of: pairs of trials of one start, all trials of some starts, or single decisions.
        batch: how many of these a step takes where nothing else is asked for.
        region: whether the reference is the policy that played the trials, as a trust region's is; else the one that training
            began with.
    """

    name: str
    summary: str
    looks_at: LooksAt
    batch: int = 2
    region: bool = False

    def steepness(self, judged: Judged, options: PreferenceOptions) -> float:
        """How fast the loss can change with the mean of |a - mu| / b; whoever adds other losses divides by it."""
        return 1.0

    @abstractmethod
    def loss(self, judged: Judged, options: PreferenceOptions) -> Float[Tensor, ""]:
        """The loss of a batch."""
