"""An objective: what a denoiser is trained to do, and how clips are drawn from it afterwards."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any

import torch
from jaxtyping import Bool, Float
from torch import Tensor

Network = Callable[[Tensor, Tensor], Tensor]
"""`network(x, t)`: the denoiser with its condition already given; x (B, T, C, h, w), t (B, T) in 0..1."""


class Objective(ABC):
    """One way to train and sample. A new one is one new file in `edream/objectives/` that defines `ENTRY`.

    Attributes:
        steps: sampling steps where the config names none.
        residual: whether the network learns what is to be added to the composite, and so is shown the clip minus the composite.
    """

    name: str
    summary: str
    steps: int
    residual: bool = False

    @abstractmethod
    def loss(
        self,
        network: Network,
        real: Float[Tensor, "B T C h w"],
        composite: Float[Tensor, "B T C h w"],
        known: Bool[Tensor, "B T"],
        chance: torch.Generator,
        options: Mapping[str, Any],
    ) -> Float[Tensor, ""]:
        """The loss of one batch; frames that are `known` are given to the network as they are and do not count."""

    @abstractmethod
    def sample(
        self,
        network: Network,
        composite: Float[Tensor, "B T C h w"],
        noise: Float[Tensor, "B T C h w"],
        steps: int,
        options: Mapping[str, Any],
        before: Float[Tensor, "B K C h w"] | None = None,
    ) -> Float[Tensor, "B T C h w"]:
        """Clips drawn from the model.

        Args:
            noise: standard normal; the same noise gives the same clip.
            before: the first K frames, already there, for clips that go on from others.
        """


def draw(shape: tuple[int, ...], chance: torch.Generator, like: Tensor) -> Tensor:
    """Standard normal numbers, drawn on the processor so that they do not depend on the device."""
    return torch.randn(shape, generator=chance).to(like)


def uniform(shape: tuple[int, ...], chance: torch.Generator, like: Tensor) -> Tensor:
    """Uniform numbers in 0..1, drawn on the processor."""
    return torch.rand(shape, generator=chance).to(like)


def wide(level: Float[Tensor, "B T"]) -> Float[Tensor, "B T 1 1 1"]:
    """A number a frame, ready to multiply latents."""
    return level[:, :, None, None, None]


def counted_mean(error: Float[Tensor, "B T C h w"], known: Bool[Tensor, "B T"]) -> Float[Tensor, ""]:
    """Mean over the frames that are not known."""
    each = error.float().mean(dim=(2, 3, 4))
    counts = (~known).float()
    return (each * counts).sum() / counts.sum().clamp(min=1.0)
