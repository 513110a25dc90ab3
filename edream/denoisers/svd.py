"""The network of Stable Video Diffusion (diffusers), its input widened for our conditions, its weights from a local folder."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from edream.core.errors import EdreamError, unknown_name
from edream.learn.checkpoint import fill, read_weights
from edream.learn.denoiser import Denoiser, FittedDenoiser, Shown, State

NEW = {"widths": (32, 64), "layers": 1, "cross": 32, "heads": 4, "save_memory": False}
STEADY = (6.0, 127.0, 0.02)  # frames per second, motion bucket and noise on the reference, as SVD was trained


class Svd(FittedDenoiser):
    """`UNetSpatioTemporalConditionModel`. It looks at all frames at once, so it does not stream, and knows one noise level for all
    frames.

    SVD's cross-attention reads a CLIP embedding of the reference image. Here it is a learned constant; the reference enters as
    latents.
    """

    streams = False

    def __init__(self, network: Any, cross: int) -> None:
        super().__init__()
        self.network = network
        self.reference = nn.Parameter(torch.zeros(1, 1, cross))

    def forward(self, x: Tensor, t: Tensor, shown: Shown, state: State | None = None) -> Tensor:
        if state is not None:
            raise EdreamError("Denoiser 'svd' works on whole clips and cannot stream; use dream.denoiser.kind=unet.")
        joined = torch.cat([x, shown.latents, shown.masks], dim=2)
        ids = torch.tensor(STEADY, device=x.device, dtype=x.dtype).expand(len(x), 3)
        return self.network(joined, t[:, -1], self.reference.expand(len(x), 1, -1), ids).sample


class StableVideo(Denoiser):
    """diffusers' spatio-temporal UNet. With `weights`, a folder as diffusers writes the `unet` of SVD or SVD-XT: its first layer
    keeps SVD's own input channels and gets zeros for what is new. Use it with `dream.objective.kind=edm` and `spread: 1.0`, and
    the codec `kl_vae` with SVD's VAE. Options for a new, small one: `widths` (multiples of 32), `layers`, `cross`, `heads`;
    for both, `save_memory`, gradient checkpointing.
    """

    name = "svd"
    summary = "diffusers' network of Stable Video Diffusion, input widened, weights from a local folder"

    def build(self, channels: int, shown: int, options: Mapping[str, Any], weights: Path | None) -> Svd:
        from diffusers.models.unets.unet_spatio_temporal_condition import UNetSpatioTemporalConditionModel as Network

        for name in options:
            if name not in NEW:
                raise unknown_name("option of denoiser 'svd':", name, NEW)
        if weights is not None:
            own = [name for name in options if name != "save_memory"]
            if own:
                raise EdreamError(
                    f"dream.denoiser.options.{own[0]} is for a new network; with weights, their config.json says how it is."
                )
            loaded = _loaded(weights, channels, shown, Network)
            return _saving(loaded) if options.get("save_memory") else loaded
        chosen = NEW | dict(options)
        widths = tuple(int(w) for w in chosen["widths"])
        if len(widths) < 2 or any(w % 32 for w in widths):
            raise EdreamError(f"dream.denoiser.options.widths is {list(widths)}; expected two or more multiples of 32.")
        downs = ("CrossAttnDownBlockSpatioTemporal",) * (len(widths) - 1) + ("DownBlockSpatioTemporal",)
        network = Network(
            in_channels=channels + shown,
            out_channels=channels,
            down_block_types=downs,
            up_block_types=tuple(name.replace("Down", "Up") for name in reversed(downs)),
            block_out_channels=widths,
            addition_time_embed_dim=16,
            projection_class_embeddings_input_dim=48,
            layers_per_block=int(chosen["layers"]),
            cross_attention_dim=int(chosen["cross"]),
            num_attention_heads=(int(chosen["heads"]),) * len(widths),
        )
        nn.init.zeros_(network.conv_out.weight)
        nn.init.zeros_(network.conv_out.bias)  # type: ignore[arg-type]
        made = Svd(network, int(chosen["cross"]))
        return _saving(made) if chosen["save_memory"] else made


def _saving(made: Svd) -> Svd:
    """The same with gradient checkpointing."""
    made.network.enable_gradient_checkpointing()
    return made


def _loaded(folder: Path, channels: int, shown: int, kind: Any) -> Svd:
    config, file = folder / "config.json", folder / "diffusion_pytorch_model.safetensors"
    if not config.is_file():
        raise EdreamError(
            f"There is no network at {folder}; expected diffusers' config.json and diffusion_pytorch_model.safetensors."
        )
    try:
        settings = json.loads(config.read_text())
        network = kind.from_config(settings | {"in_channels": channels + shown})
        cross, known = int(network.config.cross_attention_dim), int(settings["in_channels"])
    except (ValueError, TypeError, KeyError) as error:
        raise EdreamError(f"{config} is no config of SVD's network: {' '.join(str(error).split())}.") from error
    weights = read_weights(file)
    first = weights.get("conv_in.weight")
    if first is None or first.shape[1] != known or known > channels + shown or network.config.out_channels != channels:
        raise EdreamError(f"{file} does not fit latents of {channels} channels; use codec kl_vae with SVD's VAE (4 channels).")
    wide = torch.zeros(first.shape[0], channels + shown, *first.shape[2:], dtype=first.dtype)
    wide[:, :known] = first
    fill(network, weights | {"conv_in.weight": wide}, str(file))
    return Svd(network, cross)


ENTRY = StableVideo()
