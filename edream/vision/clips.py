"""Clips: stretches of conditioned episodes as tensors, with the object layer from one of three sources."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from edream.core.errors import EdreamError

LAYERS = ("real", "robot", "masks", "object_sim", "object_crop", "object_masks")
STORED = (*LAYERS, "reference")
SOURCES = ("real", "sim", "crop", "none")


@dataclass(frozen=True, eq=False)
class Scenes:
    """Conditioned episodes, their images in files that are read where they are needed.

    Attributes:
        names: of the episodes.
        layers: of each episode, layer -> (T, H, W, 3) uint8.
        references: background image of each, (H, W, 3).
        held: whether each is held out.
    """

    names: tuple[str, ...]
    layers: tuple[Mapping[str, np.ndarray], ...]
    references: tuple[np.ndarray, ...]
    held: tuple[bool, ...]

    @classmethod
    def gather(cls, episodes: Iterable[tuple[str, Mapping[str, np.ndarray]]], folder: Path, held: Collection[str]) -> "Scenes":
        """Put every episode's layers into files of `folder` that are mapped into memory, so that any number of them fits."""
        names, layers, references = [], [], []
        for number, (name, images) in enumerate(episodes):
            kept = {}
            for layer in LAYERS:
                path = folder / f"{number:06d}-{layer}.npy"
                mapped = np.lib.format.open_memmap(path, mode="w+", dtype=np.uint8, shape=images[layer].shape)
                mapped[:] = images[layer]
                kept[layer] = mapped
            names.append(name)
            layers.append(kept)
            references.append(images["reference"][0])
        return cls(tuple(names), tuple(layers), tuple(references), tuple(name in held for name in names))

    def __reduce__(self) -> tuple[Any, ...]:
        """Sent to another process, which may be on a machine that shares the folder: the files go by name."""
        named = tuple({layer: _sent(images) for layer, images in one.items()} for one in self.layers)
        return _received, (self.names, named, self.references, self.held)

    def lengths(self) -> list[int]:
        """Images of each episode."""
        return [len(one["real"]) for one in self.layers]


def _sent(images: np.ndarray) -> Path | np.ndarray:
    if not isinstance(images, np.memmap) or images.filename is None:
        return images
    images.flush()
    return Path(images.filename)


def _received(
    names: tuple[str, ...],
    layers: tuple[dict[str, Path | np.ndarray], ...],
    references: tuple[np.ndarray, ...],
    held: tuple[bool, ...],
) -> Scenes:
    opened = tuple(
        {name: np.load(one, mmap_mode="r", allow_pickle=False) if isinstance(one, Path) else one for name, one in kept.items()}
        for kept in layers
    )
    return Scenes(names, opened, references, held)


@dataclass(frozen=True, eq=False)
class Clip:
    """A batch of clips; images -1..1, shares 0..1.

    Attributes:
        real: what the camera saw, (B, T, 3, H, W).
        composite: robot and object over the background, likewise.
        background: the reference image, repeated, likewise.
        robot, object: shares of each pixel, (B, T, 1, H, W).
    """

    real: Float[Tensor, "B T 3 H W"]
    composite: Float[Tensor, "B T 3 H W"]
    background: Float[Tensor, "B T 3 H W"]
    robot: Float[Tensor, "B T 1 H W"]
    object: Float[Tensor, "B T 1 H W"]

    def to(self, device: torch.device | str) -> "Clip":
        """The same elsewhere."""
        return Clip(*(getattr(self, name).to(device) for name in ("real", "composite", "background", "robot", "object")))

    def onward(self, given: Float[Tensor, "B K 3 H W"], counts: Int[Tensor, "B"]) -> "Clip":
        """Video alone, going on from its last given image, which takes the background's place: the first `counts` of `given`;
        clips with none keep theirs."""
        last = given[torch.arange(len(given), device=given.device), (counts - 1).clamp(min=0)]
        base = torch.where((counts > 0)[:, None, None, None, None], last[:, None], self.background)
        return replace(self, composite=base, background=base)


@dataclass(frozen=True)
class Jitter:
    """How training conditions are shaken so that a model does not lean on them too much.

    Attributes:
        colour: relative spread of the object layer's colours.
        shift: how far the object layer is shifted [pixel].
        drop: share of clips whose object is left out.
    """

    colour: float = 0.05
    shift: int = 1
    drop: float = 0.1


def images(values: np.ndarray) -> Tensor:
    """uint8 images (..., H, W, 3) as a tensor -1..1, (..., 3, H, W)."""
    return torch.from_numpy(np.ascontiguousarray(values)).movedim(-1, -3).float() / 127.5 - 1.0


def share(values: np.ndarray) -> Tensor:
    """Shares 0..255, (..., H, W), as a tensor 0..1, (..., 1, H, W)."""
    return torch.from_numpy(np.ascontiguousarray(values)).float()[..., None, :, :] / 255.0


def composed(
    background: Tensor, robot: Tensor, robot_share: Tensor, thing: Tensor, thing_share: Tensor
) -> Float[Tensor, "... 3 H W"]:
    """Robot over background, object over both."""
    with_robot = background + robot_share * (robot - background)
    return with_robot + thing_share * (thing - with_robot)


def object_layer(scene: Mapping[str, np.ndarray], rows: slice, source: str) -> tuple[Tensor, Tensor]:
    """The object's colours and shares from a source: real (recorded pixels), sim (rendered), crop (moved), none."""
    if source == "real":
        found = share(scene["masks"][rows, ..., 1])
        return images(scene["real"][rows]), found
    if source in ("sim", "crop"):
        return images(scene[f"object_{source}"][rows]), share(scene["object_masks"][rows, ..., 0 if source == "sim" else 1])
    if source != "none":
        raise EdreamError(f"There is no object source {source!r}; expected one of {', '.join(SOURCES)}.")
    colour = images(scene["real"][rows])
    return torch.zeros_like(colour), torch.zeros_like(colour[..., :1, :, :])


def clip_of(
    scenes: Scenes,
    picked: Sequence[tuple[int, int, str]],
    frames: int,
    jitter: Jitter | None = None,
    rng: np.random.Generator | None = None,
) -> Clip:
    """Clips as one batch.

    Args:
        picked: for each clip, the episode's number, its first image and its object source.
        frames: length.
        jitter: how conditions are shaken, with `rng`; None to leave them.
    """
    parts: list[Clip] = []
    for number, first, source in picked:
        scene, rows = scenes.layers[number], slice(first, first + frames)
        real = images(scene["real"][rows])
        background = images(scenes.references[number]).expand_as(real)
        colour, thing = object_layer(scene, rows, source)
        if jitter is not None and rng is not None:
            colour, thing = _shaken(colour, thing, jitter, rng)
        robot = share(scene["masks"][rows, ..., 0])
        whole = composed(background, images(scene["robot"][rows]), robot, colour, thing)
        parts.append(Clip(real, whole, background, robot * (1.0 - thing), thing))
    return Clip(*(torch.stack([getattr(p, n) for p in parts]) for n in ("real", "composite", "background", "robot", "object")))


def _shaken(colour: Tensor, thing: Tensor, jitter: Jitter, rng: np.random.Generator) -> tuple[Tensor, Tensor]:
    gain = torch.from_numpy(1.0 + jitter.colour * rng.normal(size=(3, 1, 1))).float()
    dy, dx = (int(v) for v in rng.integers(-jitter.shift, jitter.shift + 1, 2)) if jitter.shift else (0, 0)
    kept = 0.0 if rng.random() < jitter.drop else 1.0
    colour = ((colour + 1.0) * gain - 1.0).clamp(-1.0, 1.0)
    return torch.roll(colour, (dy, dx), (-2, -1)), kept * torch.roll(thing, (dy, dx), (-2, -1))


def starts(scenes: Scenes, frames: int, held: bool, step: int) -> list[tuple[int, int]]:
    """Episode and first image of the clips that lie `step` apart in the episodes of one side.

    Raises:
        EdreamError: no episode of that side is long enough.
    """
    found = [
        (number, first)
        for number, length in enumerate(scenes.lengths())
        if scenes.held[number] == held
        for first in range(0, length - frames + 1, step)
    ]
    if not found:
        side = "held-out" if held else "training"
        raise EdreamError(
            f"No {side} episode has {frames} images (the longest has {max(scenes.lengths(), default=0)}); lower dream.frames, or "
            "raise render.rate."
        )
    return found
