"""The dream model as one thing: codec, denoiser and objective, for training, for clips, for long video and frame by frame."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor
from torch.nn.functional import pixel_unshuffle

from edream import catalog
from edream.core.errors import EdreamError
from edream.learn.codec import Codec, FittedCodec, flat
from edream.learn.denoiser import Denoiser, FittedDenoiser, Shown, State
from edream.learn.objective import Network, Objective
from edream.vision.clips import Clip, composed, images
from edream.vision.grain import Grain

AT_ONCE = 16  # images that are encoded or decoded at a time: that is what needs memory


@dataclass(frozen=True)
class Part:
    """An entry of a catalog, its options and its weights.

    Attributes:
        kind: name of the entry.
        options: its settings.
        weights: a file or folder of pretrained weights, or None.
    """

    kind: str
    options: Mapping[str, Any] = field(default_factory=dict)
    weights: Path | None = None


@dataclass(frozen=True, eq=False)
class Latents:
    """Latents that were made once: of the recorded images, (B, T, C, h, w), and of the background, (B, 1, C, h, w)."""

    real: Float[Tensor, "B T C h w"]
    background: Float[Tensor, "B 1 C h w"]


def new_codec(codec: Part, seed: int) -> FittedCodec:
    """The codec alone, the same as `DreamModel.of` has it.

    Raises:
        EdreamError: it does not exist, or an option or its weights are wrong.
    """
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        return _built(codec)


def _built(codec: Part) -> FittedCodec:
    return catalog.load("codecs", codec.kind, Codec).build(codec.options, codec.weights)


@torch.no_grad()
def encoded(codec: FittedCodec, images: Float[Tensor, "N 3 H W"]) -> Float[Tensor, "N C h w"]:
    """Latents of any number of images, on the processor."""
    device = next(iter(codec.state_dict().values()), torch.zeros(0)).device
    return torch.cat([codec.encode(part.to(device)).cpu() for part in images.split(AT_ONCE)])


class DreamModel(torch.nn.Module):
    """Codec and denoiser, and the objective that says how to draw clips from them.

    Attributes:
        onward: whether the last image that is given takes the background's place, where images are given.
    """

    def __init__(self, codec: FittedCodec, denoiser: FittedDenoiser, objective: Objective, options: Mapping[str, Any]) -> None:
        super().__init__()
        self.onward = False
        self.codec, self.denoiser, self.objective, self.options = codec.requires_grad_(False), denoiser, objective, dict(options)

    @classmethod
    def of(cls, codec: Part, denoiser: Part, objective: Part, seed: int) -> "DreamModel":
        """A new model, its weights drawn from `seed`.

        Raises:
            EdreamError: an entry, option or weights file is wrong.
        """
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            fitted = _built(codec)
            shown = 2 * fitted.channels + 2 * fitted.factor**2
            network = catalog.load("denoisers", denoiser.kind, Denoiser).build(
                fitted.channels, shown, denoiser.options, denoiser.weights
            )
        return cls(fitted, network, catalog.load("objectives", objective.kind, Objective), objective.options)

    def encode(self, clip: Float[Tensor, "B T 3 H W"]) -> Float[Tensor, "B T C h w"]:
        """Images as latents."""
        row, shape = flat(clip)
        with torch.autocast(clip.device.type, enabled=False):  # SVD's VAE overflows in narrow numbers
            return self.codec.encode(row.float()).unflatten(0, shape)

    def decode(self, latents: Float[Tensor, "B T C h w"]) -> Float[Tensor, "B T 3 H W"]:
        """Latents as images, a few at a time: decoding is what needs memory."""
        with torch.autocast(latents.device.type, enabled=False):
            clips = [torch.cat([self.codec.decode(part.float()) for part in clip.split(AT_ONCE)]) for clip in latents]
        return torch.stack(clips).clamp(-1.0, 1.0)

    def shown(self, clip: Clip, background: Tensor | None = None) -> tuple[Tensor, Shown]:
        """The composite's latents, and what the denoiser is shown; `background` are its latents, (B, 1, C, h, w), if kept."""
        composite = self.encode(clip.composite)
        background = (self.encode(clip.background[:, :1]) if background is None else background).expand_as(composite)
        masks = [
            pixel_unshuffle(one.flatten(0, 1), self.codec.factor).unflatten(0, one.shape[:2]) for one in (clip.robot, clip.object)
        ]
        # what robot and object change, rather than the whole image: the background is nearly the same in every clip
        return composite, Shown(torch.cat([2.0 * (composite - background), background], dim=2), 2.0 * torch.cat(masks, dim=2) - 1.0)

    def network(self, composite: Tensor, shown: Shown, caches: Iterator[State] | None = None) -> Network:
        """The denoiser with its condition given; objectives that start from the composite show it the clip less the composite."""
        base = composite if self.objective.residual else torch.zeros_like(composite)

        def run(x: Tensor, t: Tensor) -> Tensor:
            return self.denoiser(x - base, t, shown, None if caches is None else next(caches))

        return run

    def loss(self, clip: Clip, known: Tensor, chance: torch.Generator, latents: "Latents | None" = None) -> Tensor:
        """The objective's loss on a batch; `latents` of what does not change from step to step, where they are kept."""
        background = None if latents is None else latents.background
        if self.onward:
            clip = clip.onward(clip.real, known.sum(dim=1))
            background = None
        with torch.no_grad():
            composite, shown = self.shown(clip, background)
            real = self.encode(clip.real) if latents is None else latents.real
        return self.objective.loss(self.network(composite, shown), real, composite, known, chance, self.options)

    @torch.no_grad()
    def sample(
        self, clip: Clip, noise: Tensor, steps: int | None = None, before: Tensor | None = None
    ) -> Float[Tensor, "B T 3 H W"]:
        """Clips drawn from the model; `before` holds the first frames as images, where they are already there."""
        if self.onward and before is not None:
            clip = clip.onward(before, torch.full((len(before),), before.shape[1], device=before.device))
        composite, shown = self.shown(clip)
        known = None if before is None else self.encode(before)
        drawn = self.objective.sample(
            self.network(composite, shown), composite, noise, steps or self.objective.steps, self.options, known
        )
        return self.decode(drawn)

    def noise(self, clips: int, frames: int, height: int, width: int, seed: int, first: int = 0) -> Float[Tensor, "B T C h w"]:
        """Standard normal noise in which frame i of a video has always the same numbers, whatever chunk it falls into."""
        h, w = height // self.codec.factor, width // self.codec.factor
        parts = [
            torch.randn((clips, self.codec.channels, h, w), generator=torch.Generator().manual_seed(seed * 1_000_003 + first + i))
            for i in range(frames)
        ]
        return torch.stack(parts, dim=1)

    def long(self, clip: Clip, seed: int, chunk: int, overlap: int, steps: int | None = None) -> Float[Tensor, "B T 3 H W"]:
        """A video of any length, chunk by chunk; the last `overlap` frames of each are the first of the next.

        Raises:
            EdreamError: the overlap is not smaller than the chunk.
        """
        if not 0 <= overlap < chunk:
            raise EdreamError(
                f"dream.overlap is {overlap} and dream.frames {chunk}; expected an overlap below the number of frames."
            )
        b, total, _, h, w = clip.real.shape
        done = torch.zeros((b, 0, 3, h, w), device=clip.real.device)
        while done.shape[1] < total:
            first = max(0, done.shape[1] - overlap)
            part = Clip(
                *(getattr(clip, n)[:, first : first + chunk] for n in ("real", "composite", "background", "robot", "object"))
            )
            before = done[:, first:] if done.shape[1] > first else None
            noise = self.noise(b, part.real.shape[1], h, w, seed, first).to(done.device)
            made = self.sample(part, noise, steps, before)
            done = torch.cat([done, made[:, 0 if before is None else before.shape[1] :]], dim=1)
        return done


class Dreamer:
    """Frame by frame, for a policy that looks at what it does: causal in time, with a state of constant size.

    Args:
        model: trained, with a denoiser that streams.
        reference: the background image, (H, W, 3).
        grain: the sensor's noise to put back, or None.
        seed: of the model's noise.
        steps: sampling steps; the objective's own where None.

    Raises:
        EdreamError: the denoiser needs whole clips.
    """

    def __init__(
        self,
        model: DreamModel,
        reference: UInt8[np.ndarray, "H W 3"],
        grain: Grain | None = None,
        seed: int = 0,
        steps: int | None = None,
    ) -> None:
        if not model.denoiser.streams:
            raise EdreamError("This denoiser works on whole clips and cannot stream; use dream.denoiser.kind=unet.")
        self.model, self.grain, self.seed, self.steps = model.eval(), grain, seed, steps or model.objective.steps
        self._device = next(model.denoiser.parameters()).device
        self._reference = images(reference)[None, None]

    def start(self) -> "Past":
        """The state before the first frame."""
        return Past(0, tuple({} for _ in range(self.steps)))

    @torch.no_grad()
    def step(self, state: "Past", render: "Render") -> tuple["Past", UInt8[np.ndarray, "H W 3"]]:
        """The next image.

        Args:
            state: what `start` or the last `step` gave; it is used up.
            render: the simulation as it is now.

        Returns:
            The new state, and the image, (H, W, 3).
        """
        clip = render.clip(self._reference).to(self._device)
        composite, shown = self.model.shown(clip)
        network = self.model.network(composite, shown, iter(state.caches))
        h, w = clip.real.shape[-2:]
        noise = self.model.noise(1, 1, h, w, self.seed, state.frame).to(self._device)
        drawn = self.model.objective.sample(network, composite, noise, self.steps, self.model.options)
        image = self.model.decode(drawn)[0, 0]
        return Past(state.frame + 1, state.caches), finished(image[None], self.grain, self.seed, state.frame)[0]


@dataclass(frozen=True, eq=False)
class Past:
    """The state of a stream: which frame comes next, and one cache for each sampling step."""

    frame: int
    caches: tuple[State, ...]


@dataclass(frozen=True, eq=False)
class Render:
    """The simulation now: colours and shares of robot and object, as `edream.sim.camera` gives them."""

    robot: UInt8[np.ndarray, "H W 3"]
    robot_share: UInt8[np.ndarray, "H W"]
    thing: UInt8[np.ndarray, "H W 3"]
    thing_share: UInt8[np.ndarray, "H W"]

    def clip(self, reference: Tensor) -> Clip:
        """One frame as a clip before a background image."""
        robot, thing = (
            torch.from_numpy(s.astype(np.float32) / 255.0)[None, None, None] for s in (self.robot_share, self.thing_share)
        )
        whole = composed(reference, images(self.robot)[None, None], robot, images(self.thing)[None, None], thing)
        return Clip(torch.zeros_like(reference), whole, reference, robot * (1.0 - thing), thing)


def finished(frames: Float[Tensor, "T 3 H W"], grain: Grain | None, seed: int, first: int = 0) -> UInt8[np.ndarray, "T H W 3"]:
    """Images of 8 bits, with the sensor's noise put back where there is one; frame i has always the same noise."""
    values = ((frames.movedim(-3, -1).float() + 1.0) * 127.5).cpu().numpy()
    if grain is not None:
        for i, image in enumerate(values):
            rng = np.random.default_rng((seed, 0x6E, first + i))
            image += grain.at(image) * rng.standard_normal(image.shape)
    return np.clip(np.round(values), 0, 255).astype(np.uint8)
