"""A denoiser: the network that makes a clip from a noisy clip and what is known about it."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jaxtyping import Float
from torch import Tensor, nn

State = dict[str, Tensor]


@dataclass(frozen=True, eq=False)
class Shown:
    """What a denoiser is shown besides the noisy latents.

    Attributes:
        latents: of the composite and of the background, (B, T, 2 C, h, w).
        masks: robot and object, their pixels unshuffled, (B, T, 2 f f, h, w), -1..1.
    """

    latents: Float[Tensor, "B T C2 h w"]
    masks: Float[Tensor, "B T M h w"]


class FittedDenoiser(nn.Module, ABC):
    """A denoiser with weights.

    Attributes:
        streams: whether it can work frame by frame, with the past kept in a state of constant size.
    """

    streams: bool

    @abstractmethod
    def forward(
        self, x: Float[Tensor, "B T C h w"], t: Float[Tensor, "B T"], shown: Shown, state: State | None = None
    ) -> Float[Tensor, "B T C h w"]:
        """The network's output, of the latents' shape.

        Args:
            x: noisy latents.
            t: noise level of each frame, 0 (none) to 1.
            shown: the condition.
            state: the past, updated in place; None for a clip that stands alone.
        """


class Denoiser(ABC):
    """One sort of denoiser. A new one is one new file in `edream/denoisers/` that defines `ENTRY`."""

    name: str
    summary: str

    @abstractmethod
    def build(self, channels: int, shown: int, options: Mapping[str, Any], weights: Path | None) -> FittedDenoiser:
        """A new network, its last layer zero, so that it begins by passing the composite on.

        Args:
            channels: of the latents.
            shown: channels of the condition.
            options: the network's own settings.
            weights: pretrained weights, for networks that have some.

        Raises:
            EdreamError: an option does not exist or does not fit.
        """
