"""A KL autoencoder: diffusers' blocks, trained here on the recordings' images or loaded from a local folder."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from edream.core.errors import EdreamError, require, unknown_name
from edream.learn.checkpoint import fill, read_weights
from edream.learn.codec import Codec, FittedCodec

MOST = 1_000_000_000  # weights; that of Stable Video Diffusion has 98 million
NEW = {"widths": (32, 64, 64), "latent": 4, "scale": None}


class Autoencoder(FittedCodec):
    """diffusers' AutoencoderKL, or the one with SVD's temporal decoder; the latent is its mean, less each channel's `centre`, over
    each channel's `spread`."""

    lossless = False

    def __init__(self, network: Any, factor: int, channels: int, scale: float | None, temporal: bool = False) -> None:
        super().__init__()
        self.network, self.factor, self.channels, self.temporal = network, factor, channels, temporal
        self.centre = nn.Buffer(torch.zeros(channels))
        self.spread = nn.Buffer(torch.full((channels,), 1.0 if scale is None else 1.0 / scale))

    def encode(self, images: Tensor) -> Tensor:
        return (self.network.encode(images).latent_dist.mean - self.centre[:, None, None]) / self.spread[:, None, None]

    def decode(self, latents: Tensor) -> Tensor:
        about = {"num_frames": len(latents)} if self.temporal else {}
        return self.network.decode(latents * self.spread[:, None, None] + self.centre[:, None, None], **about).sample


class KlVae(Codec):
    """A KL VAE. Options for a new one: `widths` at each resolution (the factor is 2^(n-1)), `latent` channels.

    A small VAE that was trained for a minute capped PSNR at 25 dB in our measurements, so its own reconstruction is printed beside
    the model's score. Weights: a folder as diffusers writes it (config.json and diffusion_pytorch_model.safetensors), such as the
    `vae` of Stable Diffusion, or that of Stable Video Diffusion, whose decoder looks at neighbouring images: which of the two,
    its config.json says. Frame by frame (for a policy's eyes) the temporal decoder has no neighbours to look at.
    """

    name = "kl_vae"
    summary = "KL autoencoder from diffusers' blocks, trained here or loaded from a local folder, SVD's temporal decoder too"
    learned = True

    def build(self, options: Mapping[str, Any], weights: Path | None) -> Autoencoder:
        from diffusers.models.autoencoders.autoencoder_kl import AutoencoderKL
        from diffusers.models.autoencoders.autoencoder_kl_temporal_decoder import AutoencoderKLTemporalDecoder

        for name in options:
            if name not in NEW:
                raise unknown_name("option of codec 'kl_vae':", name, NEW)
        if weights is not None:
            return _loaded(weights, AutoencoderKL, AutoencoderKLTemporalDecoder)
        chosen = NEW | dict(options)
        widths = tuple(int(w) for w in chosen["widths"])
        if any(w % 32 for w in widths):
            raise EdreamError(f"dream.codec.options.widths is {list(widths)}; expected multiples of 32.")
        network = AutoencoderKL(
            down_block_types=("DownEncoderBlock2D",) * len(widths),  # type: ignore[arg-type]
            up_block_types=("UpDecoderBlock2D",) * len(widths),  # type: ignore[arg-type]
            block_out_channels=widths,  # type: ignore[arg-type]
            latent_channels=int(chosen["latent"]),
            layers_per_block=1,
            mid_block_add_attention=False,
        )
        return Autoencoder(network, 2 ** (len(widths) - 1), int(chosen["latent"]), chosen["scale"])

    def train(self, codec: FittedCodec, images: Tensor, steps: int, seed: int) -> list[float]:
        assert isinstance(codec, Autoencoder)
        rng, device = np.random.default_rng((seed, 0xC0)), next(codec.parameters()).device
        codec.requires_grad_(True).train()
        adam = torch.optim.Adam(codec.network.parameters(), lr=1e-3, betas=(0.9, 0.99))
        losses = []
        for step in range(steps):
            for group in adam.param_groups:
                group["lr"] = 1e-3 * min(1.0, (step + 1) / 20) * (1.0 - 0.95 * step / steps)
            some = images[torch.from_numpy(rng.integers(0, len(images), 16))].to(device)
            found = codec.network.encode(some).latent_dist
            sample = found.mean + found.std * torch.from_numpy(rng.standard_normal(found.mean.shape)).float().to(device)
            error = codec.network.decode(sample).sample - some
            loss = error.abs().mean() + error.square().mean() + 1e-6 * found.kl().mean()
            adam.zero_grad()
            loss.backward()
            adam.step()
            losses.append(float(loss.detach()))
        codec.requires_grad_(False).eval()
        with torch.no_grad():
            means = torch.cat([codec.network.encode(part.to(device)).latent_dist.mean for part in images[:256].split(32)])
            # by channel: a small VAE's differ fivefold, and one number for all would leave some of them in the noise of `epsilon`
            codec.centre.copy_(means.mean(dim=(0, 2, 3)))
            codec.spread.copy_(means.std(dim=(0, 2, 3)).clamp(min=1e-6))
        return losses


def _bound(settings: Mapping[str, Any]) -> None:
    """Refuse numbers that would keep diffusers building for ever."""
    for name, value in settings.items():
        several = value if isinstance(value, list) else [value]
        most = 32 if name == "layers_per_block" else 65536
        if len(several) > 64 or any(isinstance(one, int) and abs(one) > most for one in several):
            raise EdreamError(f"{name} is {str(value)[:60]}; expected at most {most}")


def _loaded(folder: Path, plain: Any, looking_around: Any) -> Autoencoder:
    import json

    file, config = folder / "diffusion_pytorch_model.safetensors", folder / "config.json"
    if not config.is_file():
        raise EdreamError(f"There is no VAE at {folder}; expected diffusers' config.json and diffusion_pytorch_model.safetensors.")
    try:
        settings = json.loads(config.read_bytes())
        temporal = settings["_class_name"] == looking_around.__name__
        kind = looking_around if temporal else plain
        _bound(settings)
        with torch.device("meta"):  # takes no memory
            size = sum(parameter.numel() for parameter in kind.from_config(settings).parameters())
        require(size <= MOST, "its number of weights", size, f"{MOST} at most")
        network = kind.from_config(settings)
        scale = float(settings.get("scaling_factor", 0.18215))
        require(0.0 < scale < float("inf"), "scaling_factor", scale, "a number above 0")
    except Exception as error:  # diffusers builds what the file says, and fails in as many ways
        raise EdreamError(f"{config} is no VAE's config: {' '.join(str(error).split())[:300]}.") from error
    fill(network, read_weights(file), str(file))
    factor = 2 ** (len(network.config.block_out_channels) - 1)
    return Autoencoder(network, factor, network.config.latent_channels, scale, temporal)


ENTRY = KlVae()
