"""A codec: how images become the latents that a denoiser works on, and back."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn


class FittedCodec(nn.Module, ABC):
    """A codec ready for use.

    Attributes:
        channels: of its latents.
        factor: how many pixels a latent covers along one side.
        lossless: whether decoding gives back what was encoded.
    """

    channels: int
    factor: int
    lossless: bool

    @abstractmethod
    def encode(self, images: Float[Tensor, "N 3 H W"]) -> Float[Tensor, "N C h w"]:
        """Images, -1..1, as latents of about unit size."""

    @abstractmethod
    def decode(self, latents: Float[Tensor, "N C h w"]) -> Float[Tensor, "N 3 H W"]:
        """Latents as images, -1..1. They are successive images of one clip, for a codec may look at neighbours."""


class Codec(ABC):
    """One sort of codec. A new one is one new file in `edream/codecs/` that defines `ENTRY`.

    Attributes:
        learned: whether it has weights; then it is made once, with the latents of all recorded images, by the stage `codec`.
    """

    name: str
    summary: str
    learned: bool = False

    @abstractmethod
    def build(self, options: Mapping[str, Any], weights: Path | None) -> FittedCodec:
        """The codec with weights from a file, or with new ones.

        Raises:
            EdreamError: an option or the weights do not fit.
        """

    def train(self, codec: FittedCodec, images: Float[Tensor, "N 3 H W"], steps: int, seed: int) -> list[float]:
        """Fit the codec to images where it has something to learn; the loss as it went on."""
        return []


def flat(images: Float[Tensor, "B T C H W"]) -> tuple[Float[Tensor, "N C H W"], tuple[int, int]]:
    """A clip's images in one row, and what it takes to put them back."""
    return images.flatten(0, 1), (images.shape[0], images.shape[1])


def reconstruction_psnr(codec: FittedCodec, clips: Sequence[Float[Tensor, "T 3 H W"]]) -> float | None:
    """What the codec alone loses [dB]; None for a lossless one. No model behind it can score better."""
    if codec.lossless:
        return None
    device = next(codec.parameters()).device
    with torch.no_grad():
        apart = [
            (codec.decode(codec.encode(clip)).clamp(-1, 1) - clip).square().mean().item()
            for clip in (one.to(device) for one in clips)
        ]
    error = sum(apart) / len(apart)
    return float(10.0 * torch.log10(torch.tensor(4.0 / max(error, 1e-12))))
