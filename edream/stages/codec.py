"""Codec: trained or loaded, judged alone, and every recorded image as latents, so that training encodes none of them."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from edream import catalog
from edream.core.stage import Artifact, Bundle, Source, Stage, Work
from edream.ingest.layered import layered_images
from edream.learn.checkpoint import arrays, fill
from edream.learn.codec import Codec, reconstruction_psnr
from edream.learn.determinism import deterministic
from edream.learn.device import device_of
from edream.vision.clips import STORED, Scenes, clip_of, starts
from edream.vision.clips import images as as_tensor
from edream.vision.dreamer import Part, encoded, new_codec
from edream.vision.trained import CODEC, latents_of

LATENTS = "latents.safetensors"


@dataclass(frozen=True)
class CodecOptions:
    """Of the dream model only its codec; see `conf/dream/full.yaml`."""

    codec: Part
    codec_steps: int = 0
    frames: int = 16
    device: str = "auto"


@dataclass(frozen=True)
class CodecConfig:
    """What codec reads."""

    dream: CodecOptions
    seed: int


def run(inputs: Mapping[str, Artifact], config: CodecConfig, work: Work) -> Bundle:
    """Train the codec where no weights are given, say what it loses on held-out clips, and encode every episode once."""
    options, about = config.dream, inputs["condition"]["summary.json"]
    scenes = Scenes.gather(layered_images(inputs["condition"], STORED), work.folder("images"), about["held"])
    with deterministic():
        codec = new_codec(options.codec, config.seed)
        taught = _taught(options, scenes, config.seed, work)
        fill(codec, {name: torch.from_numpy(array) for name, array in taught[CODEC].items()}, CODEC)
        codec.eval().to(device_of(options.device, "dream.device"))

        def one(number: int, rng: np.random.Generator) -> Bundle:
            real = encoded(codec, as_tensor(scenes.layers[number]["real"]))
            reference = encoded(codec, as_tensor(scenes.references[number])[None])
            return {LATENTS: {"real": real.numpy(), "reference": reference.numpy()}}

        made = work.shards("latents", range(len(scenes.names)), one, parallel=False)
    images = sum(scenes.lengths())
    psnr = taught["about.json"]["psnr"]
    summary = {
        "sentence": f"Codec {options.codec.kind!r} gives images back at {psnr:.1f} dB; {images} images are kept as latents.",
        "psnr": psnr,
        "losses": taught["about.json"]["losses"],
    }
    kept = {latents_of(number): shard.path(LATENTS) for number, shard in enumerate(made)}
    return kept | {CODEC: taught[CODEC], "summary.json": summary}


def _taught(options: CodecOptions, scenes: Scenes, seed: int, work: Work) -> Mapping[str, Any]:
    def fit(item: int, rng: np.random.Generator) -> Bundle:
        codec = new_codec(options.codec, seed).to(device_of(options.device, "dream.device"))
        held = [
            clip_of(scenes, [(n, f, "none")], options.frames).real[0]
            for n, f in starts(scenes, options.frames, True, options.frames)
        ]
        found: list[float] = []
        if options.codec_steps and options.codec.weights is None:
            pictures = torch.cat([clip_of(scenes, [(n, f, "none")], 1).real[0] for n, f in starts(scenes, 1, False, 5)])
            found = catalog.load("codecs", options.codec.kind, Codec).train(codec, pictures, options.codec_steps, seed)
        return {CODEC: arrays(codec), "about.json": {"losses": found, "psnr": reconstruction_psnr(codec.eval(), held[:16])}}

    return work.shards("codec", [0], fit, parallel=False)[0]


def sources(config: CodecConfig) -> Mapping[str, Source]:
    """Pretrained weights."""
    weights: Path | None = config.dream.codec.weights
    return {} if weights is None else {"codec": weights}


ENTRY = Stage("codec", 2, ("condition",), CodecConfig, run, sources, ("torch", "numpy", "diffusers"))
