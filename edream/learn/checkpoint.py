"""Weights on disk: safetensors only, checked name by name before a network takes them."""

import hashlib
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch
from torch import nn

from edream.core.errors import EdreamError

PICKLES = (b"PK\x03\x04", b"\x80\x02", b"\x80\x03", b"\x80\x04", b"\x80\x05")


def read_weights(path: Path) -> dict[str, torch.Tensor]:
    """Tensors of a safetensors file.

    Raises:
        EdreamError: there is none, it is pickled, or it is damaged.
    """
    from safetensors import SafetensorError
    from safetensors.torch import load_file

    if not path.is_file():
        raise EdreamError(f"There are no weights at {path}; expected a .safetensors file.")
    with path.open("rb") as stream:
        head = stream.read(4)
    if head.startswith(PICKLES):
        raise EdreamError(f"{path} is a pickled checkpoint, which can run code when it is loaded; expected a .safetensors file.")
    try:
        return load_file(path)
    except (SafetensorError, ValueError, OSError) as error:
        raise EdreamError(f"{path} is no safetensors file or is damaged: {' '.join(str(error).split())}.") from error


def fill(
    module: nn.Module,
    weights: Mapping[str, torch.Tensor],
    where: str,
    hint: str = "check the settings under dream.codec and dream.denoiser",
) -> None:
    """Give a network its weights, all of them and no others.

    Args:
        where: how messages name the weights.
        hint: what to do where they do not fit.

    Raises:
        EdreamError: a tensor is missing, unknown, of another shape, or holds numbers that are not finite.
    """
    own = module.state_dict()
    missing, more = sorted(own.keys() - weights.keys()), sorted(weights.keys() - own.keys())
    if missing or more:
        first = f"{missing[0]!r} is missing" if missing else f"{more[0]!r} is unknown"
        raise EdreamError(
            f"{where} does not fit this network: {first} ({len(missing)} tensors missing, {len(more)} unknown); {hint}."
        )
    for name, tensor in weights.items():
        if tensor.shape != own[name].shape:
            raise EdreamError(
                f"{where} does not fit this network: {name!r} is {tuple(tensor.shape)}; expected {tuple(own[name].shape)}."
            )
        if tensor.is_floating_point() and not torch.isfinite(tensor).all():
            raise EdreamError(f"{where} is damaged: {name!r} holds numbers that are not finite.")
    module.load_state_dict({name: tensor.to(own[name].dtype) for name, tensor in weights.items()})


def arrays(module: nn.Module, prefix: str = "") -> dict[str, np.ndarray]:
    """A network's weights as arrays."""
    return {prefix + name: tensor.detach().cpu().numpy().copy() for name, tensor in module.state_dict().items()}


def weights_digest(weights: Mapping[str, np.ndarray]) -> str:
    """SHA-256 over names, shapes and bytes: two networks with the same digest are the same."""
    total = hashlib.sha256()
    for name in sorted(weights):
        array = np.ascontiguousarray(weights[name])
        total.update(f"{name}\0{array.dtype.str}\0{array.shape}\0".encode())
        total.update(array.tobytes())
    return total.hexdigest()
