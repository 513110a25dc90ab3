"""A lossless codec: blocks of pixels become channels."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from torch import Tensor
from torch.nn.functional import pixel_shuffle, pixel_unshuffle

from edream.core.errors import EdreamError, unknown_name
from edream.learn.codec import Codec, FittedCodec


class Unshuffled(FittedCodec):
    """Blocks of `factor` x `factor` pixels as 3 factor^2 channels."""

    lossless = True

    def __init__(self, factor: int) -> None:
        super().__init__()
        self.factor, self.channels = factor, 3 * factor * factor

    def encode(self, images: Tensor) -> Tensor:
        return pixel_unshuffle(images, self.factor)

    def decode(self, latents: Tensor) -> Tensor:
        return pixel_shuffle(latents, self.factor)


class PixelUnshuffle(Codec):
    """Nothing to learn and nothing lost: right for small images, where a small VAE would cap the score."""

    name = "pixel_unshuffle"
    summary = "lossless; blocks of pixels become channels (option factor: 1, 2, 4 or 8)"

    def build(self, options: Mapping[str, Any], weights: Path | None) -> Unshuffled:
        for name in options:
            if name != "factor":
                raise unknown_name("option of codec 'pixel_unshuffle':", name, ("factor",))
        factor = options.get("factor", 2)
        if factor not in (1, 2, 4, 8) or weights is not None:
            raise EdreamError(f"Codec 'pixel_unshuffle' has factor {factor!r}; expected 1, 2, 4 or 8, and no weights.")
        return Unshuffled(int(factor))


ENTRY = PixelUnshuffle()
