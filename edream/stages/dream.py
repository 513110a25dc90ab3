"""Dream: train the model that makes renderings look real, and beside it what it is compared with."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from edream import catalog
from edream.core.stage import Artifact, Bundle, Source, Stage, Work
from edream.ingest.layered import layered_images
from edream.learn import ranks
from edream.learn.checkpoint import fill, weights_digest
from edream.learn.codec import Codec
from edream.learn.determinism import deterministic
from edream.learn.device import device_of
from edream.learn.training import AVERAGE, State, new_state, part, train
from edream.vision.batches import Batches, KeptLatents
from edream.vision.clips import STORED, Scenes, starts
from edream.vision.dreamer import DreamModel
from edream.vision.grain import Grain, measured_grain
from edream.vision.judging import drawn
from edream.vision.trained import CODEC, file_of, latents_of, loaded
from edream.vision.variants import DreamOptions, Variant, new_model, variants


@dataclass(frozen=True)
class DreamConfig:
    """What dream reads."""

    dream: DreamOptions
    seed: int


def run(inputs: Mapping[str, Artifact], config: DreamConfig, work: Work) -> Bundle:
    """Train each variant in pieces that are kept, so that a run that was killed goes on at its last piece."""
    options, about = config.dream, inputs["condition"]["summary.json"]
    bundle: dict[str, Any] = {}
    grains: dict[str, tuple[float, ...]] = {}
    losses: dict[str, list[float]] = {}
    with deterministic():
        trainer = Trainer.of(inputs, config, work.folder("images"))
        for held in (True, False):  # said before anything is trained, rather than after
            starts(trainer.scenes, options.frames, held, options.frames)
        for number, variant in enumerate(trainer.variants):
            state, losses[variant.name] = _trained(trainer, number, work)
            bundle[file_of(variant.name)] = {name: value.numpy() for name, value in part(state, AVERAGE).items()}
            model = loaded(bundle | trainer.codec, options, variant, config.seed)
            grain = _missing_grain(model, variant, trainer.scenes, options, Grain(tuple(about["grain"])), config.seed)
            grains[variant.name] = grain.levels
    chosen = trainer.variants
    size = sum(array.size for array in bundle[file_of(chosen[0].name)].values())
    codec = inputs["codec"]["summary.json"] if "codec" in inputs else {"psnr": None, "losses": []}
    summary = {
        "sentence": f"{len(chosen)} models of {size / 1e6:.2f} M parameters trained for {options.train.steps} steps each.",
        "parameters": size,
        "weights_digest": weights_digest(bundle[file_of(chosen[0].name)]),
        "codec_psnr": codec["psnr"],
        "variants": [variant.name for variant in chosen],
    }
    told = {"summary.json": summary, "losses.json": {"codec": codec["losses"], **losses}, "grain.json": grains}
    return bundle | trainer.codec | told


@dataclass(eq=False)
class Trainer:
    """All that trains the variants, and the one at work; every process that trains has one.

    Attributes:
        codec: the weights of the codec under its file's name; empty where it has none.
    """

    scenes: Scenes
    latents: KeptLatents | None
    codec: dict[str, dict[str, np.ndarray]]
    options: DreamOptions
    seed: int
    variants: Sequence[Variant]
    _at_work: tuple[int, DreamModel, Batches] | None = None

    @classmethod
    def of(cls, inputs: Mapping[str, Artifact], config: DreamConfig, folder: Path) -> "Trainer":
        """With the images, and the latents where there are some, in files of `folder`."""
        about = inputs["condition"]["summary.json"]
        scenes = Scenes.gather(layered_images(inputs["condition"], STORED), folder, about["held"])
        latents, codec = None, {}
        if "codec" in inputs:
            codec = {CODEC: dict(inputs["codec"][CODEC])}
            each = (inputs["codec"][latents_of(number)] for number in range(len(scenes.names)))
            latents = KeptLatents.gather(each, folder)
        chosen = variants(config.dream, tuple(about["object_sources"]))
        return cls(scenes, latents, codec, config.dream, config.seed, chosen)

    def begin(self, number: int) -> State:
        """Take up a variant; its state before the first step."""
        if self._at_work is None or self._at_work[0] != number:
            model = new_model(self.options, self.variants[number], self.seed)
            for weights in self.codec.values():
                fill(model.codec, {name: torch.from_numpy(np.array(array)) for name, array in weights.items()}, CODEC)
            model.to(device_of(self.options.device, "dream.device"))
            if self.options.compile:
                model.denoiser.compile()
            batches = Batches(self.scenes, self.options, self.variants[number], self.seed, self.latents)
            self._at_work = number, model, batches
        return new_state(self._at_work[1].denoiser)

    def piece(self, state: State, first: int, last: int) -> tuple[State, list[float]]:
        """Steps `first` up to `last` of the variant at work."""
        assert self._at_work is not None
        _, model, batches = self._at_work
        device, network = device_of(self.options.device, "dream.device"), model.denoiser
        model.denoiser = ranks.as_one(network)  # type: ignore[assignment]

        def loss_of(step: int) -> torch.Tensor:
            batch = batches.at(step).to(device)
            return model.loss(batch.clip, batch.known, batch.chance, batch.latents)

        try:
            return train(network, loss_of, state, first, last, self.options.train, together=True)
        finally:
            model.denoiser = network


def _trained(trainer: Trainer, number: int, work: Work) -> tuple[State, list[float]]:
    options = trainer.options
    begun = trainer.begin(number)
    before: Artifact | None = None
    losses: list[float] = []
    for first in range(0, options.train.steps, options.checkpoint):
        last = min(first + options.checkpoint, options.train.steps)

        def piece(state: Artifact | None, rng: np.random.Generator, first: int = first, last: int = last) -> Bundle:
            known = dict(begun if state is None else state["state.safetensors"])
            ranks.lead((number, first, last), known)
            made, found = trainer.piece(known, first, last)
            return {"state.safetensors": made, "losses.json": found}

        name = f"{trainer.variants[number].name}-{first:07d}"
        before = work.shards(name, [before], piece, parallel=False)[0]
        losses += before["losses.json"]
    assert before is not None
    return before["state.safetensors"], losses


def follow(inputs: Mapping[str, Artifact], config: DreamConfig, folder: Path) -> None:
    """Train the pieces that the first process names, with it."""
    with deterministic():
        trainer = Trainer.of(inputs, config, folder)
        for number, first, last in ranks.orders():
            trainer.piece(ranks.followed(trainer.begin(number)), first, last)


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


def needs(config: DreamConfig) -> tuple[str, ...]:
    """The conditions, and the codec with its latents where it has weights."""
    learned = catalog.load("codecs", config.dream.codec.kind, Codec).learned
    return ("condition", "codec") if learned else ("condition",)


ENTRY = Stage("dream", 1, needs, DreamConfig, run, sources, ("torch", "numpy"), follow)
