"""Training batches: clips drawn by seed and step alone, and latents of recorded images that were made once."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from edream.core.errors import EdreamError
from edream.learn import ranks
from edream.vision.clips import Clip, Scenes, clip_of
from edream.vision.dreamer import Latents
from edream.vision.variants import DreamOptions, Variant


@dataclass(frozen=True, eq=False)
class Batch:
    """What one step of training needs.

    Attributes:
        clip: conditions and what should come of them.
        known: frames that are given, (B, T).
        chance: for the objective's noise.
        latents: of the recorded images, or None where the codec is so simple that nothing is kept.
    """

    clip: Clip
    known: torch.Tensor
    chance: torch.Generator
    latents: Latents | None = None

    def to(self, device: torch.device) -> "Batch":
        """The same elsewhere."""
        kept = self.latents and Latents(self.latents.real.to(device), self.latents.background.to(device))
        return Batch(self.clip.to(device), self.known.to(device), self.chance, kept)


@dataclass(frozen=True, eq=False)
class KeptLatents:
    """Latents of every episode, in files mapped into memory: of its images, (T, C, h, w), and of its background, (C, h, w)."""

    real: tuple[np.ndarray, ...]
    reference: tuple[np.ndarray, ...]

    @classmethod
    def gather(cls, episodes: Iterable[Mapping[str, np.ndarray]], folder: Path) -> "KeptLatents":
        """Put each episode's `real` and `reference` into files of `folder`."""
        real, reference = [], []
        for number, one in enumerate(episodes):
            path = folder / f"{number:06d}.npy"
            np.save(path, one["real"])
            real.append(np.load(path, mmap_mode="r", allow_pickle=False))
            reference.append(np.array(one["reference"][0]))
        return cls(tuple(real), tuple(reference))

    def of(self, picked: Iterable[tuple[int, int, str]], frames: int) -> Latents:
        """Those of some clips."""
        some = list(picked)
        real = np.stack([self.real[n][first : first + frames] for n, first, _ in some])
        background = np.stack([self.reference[n][None] for n, _, _ in some])
        return Latents(torch.from_numpy(real), torch.from_numpy(background))


@dataclass(frozen=True, eq=False)
class Batches:
    """The batch of each step, which follows from the seed, the step's number and the number of processes alone.

    Where several processes train together each has its share of the clips and chances of its own.
    """

    scenes: Scenes
    options: DreamOptions
    variant: Variant
    seed: int
    latents: KeptLatents | None = None

    def at(self, step: int) -> Batch:
        """Clips, which of their frames are known, and a generator for the noise.

        Raises:
            EdreamError: no training episode is long enough, or the batch cannot be shared evenly.
        """
        rng = np.random.default_rng((self.seed, step))
        frames, count, world = self.options.train_frames, self.options.batch, ranks.world()
        if count % world:
            raise EdreamError(f"dream.batch is {count}, which {world} processes cannot share evenly; give a multiple of {world}.")
        long = [n for n, size in enumerate(self.scenes.lengths()) if not self.scenes.held[n] and size >= frames]
        if not long:
            raise EdreamError(f"No training episode has {frames} images; lower dream.train_frames, or raise render.rate.")
        names, weights = list(self.variant.sources), np.array(list(self.variant.sources.values()))
        picked = []
        for _ in range(count):
            number = long[int(rng.integers(len(long)))]
            first = int(rng.integers(self.scenes.lengths()[number] - frames + 1))
            picked.append((number, first, str(rng.choice(names, p=weights / weights.sum()))))
        if world > 1:
            picked, rng = picked[ranks.rank() :: world], np.random.default_rng((self.seed, step, 0xDD, ranks.rank()))
        clip = clip_of(self.scenes, picked, frames, self.options.jitter, rng)
        known = np.zeros((len(picked), frames), bool)
        for row in np.flatnonzero(rng.random(len(picked)) < self.options.known):
            known[row, : int(rng.integers(1, max(2, self.options.overlap + 1)))] = True
        chance = torch.Generator().manual_seed(int(rng.integers(2**62)))
        return Batch(clip, torch.from_numpy(known), chance, None if self.latents is None else self.latents.of(picked, frames))
