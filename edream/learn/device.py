"""Where networks are trained and run."""

import os

import torch

from edream.core.errors import EdreamError


def device_of(asked: str, setting: str) -> torch.device:
    """The device that a setting asks for.

    Args:
        asked: auto, cpu or cuda.
        setting: its name in the config, for the error.

    Raises:
        EdreamError: a GPU is asked for and there is none.
    """
    if asked == "cuda" and not torch.cuda.is_available():
        raise EdreamError(f"{setting} is cuda, but torch finds no GPU here; use {setting}=auto.")
    if asked == "cpu" or not torch.cuda.is_available():
        return torch.device("cpu")
    # cuBLAS repeats its bytes only so, and torch refuses every product without it; it is read before the first one
    os.environ.setdefault("CUBLAS_WORKSPACE_CONFIG", ":4096:8")
    return torch.device("cuda")


def acting_on(asked: str) -> str:
    """Where a policy acts in trials: on the processor, where a small network is as fast, unless a GPU is asked for by name, as
    large ones need it.

    Args:
        asked: auto, cpu or cuda.
    """
    return "cuda" if asked == "cuda" else "cpu"
