"""What a surrogate is: a learned, differentiable stand-in for the simulator."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from edream.calibration.windows import Sequences

if TYPE_CHECKING:
    import torch


class Surrogate(ABC):
    """One kind of surrogate. A new one is one new file in `edream/surrogates/` that defines `ENTRY`.

    `ENTRY` is an untrained surrogate; `fit` and `load` return trained ones.
    """

    name: str
    summary: str

    @abstractmethod
    def fit(self, sweep: Sequences, options: Mapping[str, Any], seed: int) -> "Surrogate":
        """A surrogate learned from simulated sequences; with the same seed and thread count, the same to the last bit."""

    @abstractmethod
    def predict(self, values: "torch.Tensor", windows: Sequences) -> "torch.Tensor":
        """Joint positions over whole windows, from their first states, differentiable in the values.

        Args:
            values: points of the unit box, (N, P), one for each window, or (P,) for all.
            windows: first states, commands, time steps and factors, N windows of T rows.

        Returns:
            Positions [rad], (N, T, J); row 0 is the first state.
        """

    @abstractmethod
    def trust(self, values: Float[np.ndarray, "N P"], windows: Sequences) -> Float[np.ndarray, "N"]:
        """How far the members of the ensemble disagree on these windows [rad]; compare with the held-out error.

        Args:
            values: points of the unit box, (N, P), each tried on all windows.
        """

    @abstractmethod
    def weights(self) -> Mapping[str, np.ndarray]:
        """All that was learned, as arrays."""

    @abstractmethod
    def load(self, weights: Mapping[str, np.ndarray]) -> "Surrogate":
        """The surrogate with these weights; inverse of `weights`."""

    @abstractmethod
    def errors(self, sweep: Sequences) -> dict[str, float]:
        """Error on simulated sequences that it was not shown: one step and whole windows [rad], and that of standing still."""
