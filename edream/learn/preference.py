"""What it means to learn from trials that went better or worse: one objective per file in `edream/preferences/`."""

from abc import ABC, abstractmethod
from dataclasses import dataclass

from jaxtyping import Bool, Float, Int
from torch import Tensor

from edream.core.errors import require


@dataclass(frozen=True)
class PreferenceOptions:
    """What the objectives read.

    Attributes:
        beta: how sharply a difference of log-ratios counts.
        alpha: weight of the chosen trajectory's own error; 0 is the paper's form of TPO.
        clip: how far a ratio may move before it stops to count (grpo).
    """

    beta: float = 0.005
    alpha: float = 1.0
    clip: float = 0.2

    def __post_init__(self) -> None:
        require(self.beta > 0, "rl.beta", self.beta, "a number above 0")
        require(self.alpha >= 0, "rl.alpha", self.alpha, "0 or more")
        require(self.clip > 0, "rl.clip", self.clip, "a number above 0")


@dataclass(frozen=True, eq=False)
class Judged:
    """N trajectories under the policy that learns.

    Attributes:
        ratio: log-likelihood of what was executed less that under the reference, summed over steps and actuators, (N,).
        error: sum of |a - mu| / b over the same, (N,).
        size: how many numbers were summed, (N,).
        chosen, rejected: rows of each pair, (P,).
        advantage: how much better than the other trials of its start each was, in their spreads, (N,).
        good: whether a trajectory is one to imitate, (N,).
    """

    ratio: Float[Tensor, "N"]
    error: Float[Tensor, "N"]
    size: Float[Tensor, "N"]
    chosen: Int[Tensor, "P"]
    rejected: Int[Tensor, "P"]
    advantage: Float[Tensor, "N"]
    good: Bool[Tensor, "N"]


class Preference(ABC):
    """One way to learn from trials. A new one is one new file in `edream/preferences/` that defines `ENTRY`.

    Attributes:
        pairs: whether batches are pairs of one start; else they are all trials of some starts.
    """

    name: str
    summary: str
    pairs: bool

    def steepness(self, judged: Judged, options: PreferenceOptions) -> float:
        """How fast the loss can change with the mean of |a - mu| / b; whoever adds other losses divides by it."""
        return 1.0

    @abstractmethod
    def loss(self, judged: Judged, options: PreferenceOptions) -> Float[Tensor, ""]:
        """The loss of a batch."""
