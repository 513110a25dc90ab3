"""What a policy is to the stages: a network that turns what is seen into a chunk of actions, all in normalised units."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from edream.core.errors import EdreamError


@dataclass(frozen=True)
class PolicyShape:
    """The numbers that a policy's network is built for.

    Attributes:
        actions: actuators, A.
        chunk: actions predicted at once, H.
        cameras: number of views, V; 0 without cameras.
        height, width: size of each view [pixel].
        state: further numbers that are seen, S, such as object poses; 0 for none.
    """

    actions: int
    chunk: int
    cameras: int
    height: int
    width: int
    state: int = 0


@dataclass(frozen=True, eq=False)
class Seen:
    """A batch of observations: joints and state normalised, images 0..255.

    Attributes:
        joints: (B, A).
        images: (B, V, H, W, 3) uint8.
        state: (B, S).
    """

    joints: Float[Tensor, "B A"]
    images: Tensor
    state: Float[Tensor, "B S"]

    def __len__(self) -> int:
        return len(self.joints)

    def to(self, device: torch.device | str) -> "Seen":
        """The same elsewhere."""
        return Seen(self.joints.to(device), self.images.to(device), self.state.to(device))

    def without_joints(self, hidden: Bool[Tensor, "B"] | None = None) -> "Seen":
        """The same with the joints of some samples (of all where None) at their mean, which tells nothing."""
        keep = torch.zeros(len(self), dtype=torch.bool) if hidden is None else ~hidden
        return replace(self, joints=self.joints * keep[:, None].to(self.joints.device))


class FittedPolicy(nn.Module, ABC):
    """A policy's network.

    Attributes:
        latent: size of the style variable z; its mean, 0, is what the policy does when nothing is left to chance.
    """

    latent: int

    @abstractmethod
    def chunk(self, seen: Seen, z: Float[Tensor, "B Z"] | None = None) -> Float[Tensor, "B H A"]:
        """The actions from now on; z = 0 where None."""

    @abstractmethod
    def loss(
        self, seen: Seen, actions: Float[Tensor, "B H A"], valid: Bool[Tensor, "B H"], chance: torch.Generator
    ) -> Float[Tensor, ""]:
        """The training loss over steps that are no padding."""


class Policy(ABC):
    """One kind of policy. A new one is one new file in `edream/policies/` that defines `ENTRY`."""

    name: str
    summary: str

    @abstractmethod
    def build(self, shape: PolicyShape, options: Mapping[str, Any]) -> FittedPolicy:
        """A new network, its weights drawn from torch's generator.

        Raises:
            EdreamError: an option is unknown or out of its range.
        """


@dataclass(frozen=True, eq=False)
class Scale:
    """Mean and spread of each number of a vector, for networks that want numbers around 0.

    Attributes:
        mean, spread: (N,); the spread is never below a floor, so that a joint that never moved is not blown up.
    """

    mean: Float[np.ndarray, "N"]
    spread: Float[np.ndarray, "N"]

    @classmethod
    def of(cls, values: Float[np.ndarray, "K N"], floor: float = 1e-2) -> "Scale":
        """From rows of values."""
        mean = values.mean(axis=0) if len(values) else np.zeros(values.shape[1])
        spread = values.std(axis=0) if len(values) else np.ones(values.shape[1])
        return cls(mean.astype(np.float32), np.maximum(spread, floor).astype(np.float32))

    def into(self, values: Float[np.ndarray, "... N"]) -> Float[np.ndarray, "... N"]:
        """SI -> normalised, float32."""
        return ((values - self.mean) / self.spread).astype(np.float32)

    def back(self, values: Float[np.ndarray, "... N"]) -> Float[np.ndarray, "... N"]:
        """Normalised -> SI, float64."""
        return values.astype(np.float64) * self.spread + self.mean


def masked_l1(made: Float[Tensor, "B H A"], wanted: Float[Tensor, "B H A"], valid: Bool[Tensor, "B H"]) -> Float[Tensor, ""]:
    """Mean absolute error over the steps that are no padding."""
    weight = valid[..., None].to(made.dtype).expand_as(made)
    return ((made - wanted).abs() * weight).sum() / weight.sum().clamp(min=1.0)


def log_likelihood(
    actions: Float[Tensor, "B ... A"], mean: Float[Tensor, "B ... A"], valid: Bool[Tensor, "B ..."], scale: float, kind: str
) -> Float[Tensor, "B"]:
    """Log-density of executed actions under independent noise around the policy's mean, summed over steps and actuators.

        laplace:  sum -|a - mu| / b - log(2 b)          gaussian:  sum -(a - mu)^2 / (2 b^2) - log(b sqrt(2 pi))

    Args:
        valid: which steps were executed and are no padding.
        scale: b, in normalised units.

    Raises:
        EdreamError: there is no such likelihood.
    """
    if kind == "laplace":
        each = -(actions - mean).abs() / scale - float(np.log(2.0 * scale))
    elif kind == "gaussian":
        each = -((actions - mean) ** 2) / (2.0 * scale**2) - float(np.log(scale * np.sqrt(2.0 * np.pi)))
    else:
        raise EdreamError(f"rl.likelihood is {kind!r}; expected laplace or gaussian.")
    return (each * valid[..., None].to(each.dtype)).flatten(1).sum(dim=1)
