"""Trained models as the stage `dream` leaves them."""

from collections.abc import Mapping
from typing import Any

import torch

from edream.learn.checkpoint import fill
from edream.learn.device import device_of
from edream.vision.dreamer import DreamModel
from edream.vision.variants import DreamOptions, Variant, new_model

CODEC = "codec.safetensors"


def file_of(variant: str) -> str:
    """Where the weights of a variant lie."""
    return f"{variant.replace(' ', '_')}.safetensors"


def latents_of(episode: int) -> str:
    """Where the stage `codec` leaves the latents of an episode."""
    return f"latents/{episode:06d}.safetensors"


def loaded(trained: Mapping[str, Any], options: DreamOptions, variant: Variant, seed: int) -> DreamModel:
    """A trained model, ready to draw from.

    Args:
        trained: file name -> tensors, as the stage `dream` makes it.

    Raises:
        EdreamError: the weights do not fit the options, or pretrained ones, whose config says how the network is built, are gone.
    """
    model = new_model(options, variant, seed)
    if CODEC in trained:
        fill(model.codec, {name: torch.from_numpy(array) for name, array in trained[CODEC].items()}, CODEC)
    name = file_of(variant.name)
    fill(model.denoiser, {key: torch.from_numpy(array) for key, array in trained[name].items()}, name)
    return model.eval().to(device_of(options.device, "dream.device"))
