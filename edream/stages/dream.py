"""Dream: train the model that makes renderings look real, and beside it what it is compared with."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from edream import catalog
from edream.core.stage import Artifact, Bundle, Source, Stage, Work
from edream.ingest.layered import layered_images
from edream.learn.checkpoint import arrays, fill, weights_digest
from edream.learn.codec import Codec, reconstruction_psnr
from edream.learn.determinism import deterministic
from edream.learn.training import AVERAGE, State, new_state, part, train
from edream.vision.clips import STORED, Scenes, clip_of, starts
from edream.vision.dreamer import DreamModel
from edream.vision.grain import Grain, measured_grain
from edream.vision.judging import drawn
from edream.vision.trained import CODEC, file_of, loaded
from edream.vision.variants import Batches, DreamOptions, Variant, device_of, new_model, variants


@dataclass(frozen=True)
class DreamConfig:
    """What dream reads."""

    dream: DreamOptions
    seed: int


def run(inputs: Mapping[str, Artifact], config: DreamConfig, work: Work) -> Bundle:
    """Train each variant in pieces that are kept, so that a run that was killed goes on at its last piece."""
    options, about = config.dream, inputs["condition"]["summary.json"]
    scenes = Scenes.gather(layered_images(inputs["condition"], STORED), work.folder("images"), about["held"])
    chosen = variants(options, tuple(about["object_sources"]))
    bundle: dict[str, Any] = {}
    grains: dict[str, tuple[float, ...]] = {}
    losses: dict[str, list[float]] = {}
    with deterministic():
        codec, codec_losses, codec_psnr = _codec(options, chosen[0], scenes, config.seed, work)
        for variant in chosen:
            state, losses[variant.name] = _trained(options, variant, scenes, codec, config.seed, work)
            bundle[file_of(variant.name)] = {name: value.numpy() for name, value in part(state, AVERAGE).items()}
            model = loaded(bundle | ({CODEC: codec} if codec else {}), options, variant, config.seed)
            grains[variant.name] = _missing_grain(model, variant, scenes, options, Grain(tuple(about["grain"])), config.seed).levels
    if codec:
        bundle[CODEC] = codec
    size = sum(array.size for array in bundle[file_of(chosen[0].name)].values())
    digest = weights_digest(bundle[file_of(chosen[0].name)])
    summary = {
        "sentence": f"{len(chosen)} models of {size / 1e6:.2f} M parameters trained for {options.train.steps} steps each.",
        "parameters": size,
        "weights_digest": digest,
        "codec_psnr": codec_psnr,
        "variants": [variant.name for variant in chosen],
    }
    return bundle | {"summary.json": summary, "losses.json": {"codec": codec_losses, **losses}, "grain.json": grains}


def _codec(
    options: DreamOptions, variant: Variant, scenes: Scenes, seed: int, work: Work
) -> tuple[dict[str, np.ndarray], list[float], float | None]:
    """Weights of the codec where it has some, and what it loses on held-out images."""

    def fit(item: int, rng: np.random.Generator) -> Bundle:
        model = new_model(options, variant, seed)
        found: list[float] = []
        if options.codec_steps:
            pictures = torch.cat([clip_of(scenes, [(n, f, "none")], 1).real[0] for n, f in starts(scenes, 1, False, 5)])
            found = catalog.load("codecs", options.codec.kind, Codec).train(model.codec, pictures, options.codec_steps, seed)
        held = torch.cat([clip_of(scenes, [(n, f, "none")], 1).real[0] for n, f in starts(scenes, 1, True, 8)])
        about = {"losses": found, "psnr": reconstruction_psnr(model.codec, held)}
        return {CODEC: arrays(model.codec), "about.json": about}

    if not arrays(new_model(options, variant, seed).codec):
        return {}, [], None
    kept = work.shards("codec", [0], fit, parallel=False)[0]
    return kept[CODEC], kept["about.json"]["losses"], kept["about.json"]["psnr"]


def _trained(
    options: DreamOptions, variant: Variant, scenes: Scenes, codec: Mapping[str, np.ndarray], seed: int, work: Work
) -> tuple[State, list[float]]:
    model = new_model(options, variant, seed)
    if codec:
        fill(model.codec, {name: torch.from_numpy(array) for name, array in codec.items()}, "The codec's weights")
    device = device_of(options)
    model.to(device)
    batches = Batches(scenes, options, variant, seed)

    def loss_of(step: int) -> torch.Tensor:
        clip, known, chance = batches.at(step)
        return model.loss(clip.to(device), known.to(device), chance)

    before: Artifact | None = None
    losses: list[float] = []
    for first in range(0, options.train.steps, options.checkpoint):
        last = min(first + options.checkpoint, options.train.steps)

        def piece(state: Artifact | None, rng: np.random.Generator, first: int = first, last: int = last) -> Bundle:
            begun = new_state(model.denoiser) if state is None else state["state.safetensors"]
            made, found = train(model.denoiser, loss_of, begun, first, last, options.train)
            return {"state.safetensors": made, "losses.json": found}

        before = work.shards(f"{variant.name}-{first:07d}", [before], piece, parallel=False)[0]
        losses += before["losses.json"]
    assert before is not None
    return before["state.safetensors"], losses


def _missing_grain(model: DreamModel, variant: Variant, scenes: Scenes, options: DreamOptions, camera: Grain, seed: int) -> Grain:
    """The camera's noise less what the model's own images have of it, on a few training clips."""
    picked = starts(scenes, options.frames, False, options.frames)
    some = [picked[i] for i in np.unique(np.linspace(0, len(picked) - 1, 8).astype(int))]
    own = measured_grain(drawn(model, scenes, some, options.frames, next(iter(variant.sources)), seed, None))
    return camera.less(own)


def sources(config: DreamConfig) -> Mapping[str, Source]:
    """Pretrained weights."""
    given = {"codec": config.dream.codec.weights, "denoiser": config.dream.denoiser.weights}
    return {name: path for name, path in given.items() if path is not None}


ENTRY = Stage("dream", 1, ("condition",), DreamConfig, run, sources, ("torch", "numpy"))
