"""Trials that succeeded, as something to imitate: they hold starts that no demonstration showed."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pyarrow as pa
import torch
from jaxtyping import Bool

from edream.learn.policy import Seen
from edream.practice.about import PolicyAbout
from edream.practice.learning import Played
from edream.practice.shaking import Shake, shaken


@dataclass(frozen=True, eq=False)
class Successes:
    """What was seen at a decision of a successful trial, with the chunk that was executed from there on.

    Every start that was ever done counts the same, however many of its trials succeeded: else the easy ones would be learned most.

    Attributes:
        played: all trials.
        groups: for each start that was done, the numbers of the trials that did it.
        about: the policy's scales and its chunk.
    """

    played: Played
    groups: Sequence[Sequence[int]]
    about: PolicyAbout
    batch: int
    seed: int
    shake: Shake | None = None

    @classmethod
    def of(
        cls, played: Played, ranks: pa.Table, about: PolicyAbout, batch: int, seed: int, shake: Shake | None = None
    ) -> "Successes":
        """From the trials and what the stage rank made of them."""
        good = [row for row in ranks.to_pylist() if row["good"]]
        groups = [sorted(row["trial"] for row in good if row["start"] == s) for s in sorted({row["start"] for row in good})]
        return cls(played, groups, about, batch, seed, shake)

    def at(self, step: int) -> tuple[Seen, torch.Tensor, Bool[torch.Tensor, "B H"], torch.Generator]:
        """The batch of a training step: what is seen, the actions (B, H, A), which of them are no padding, and a generator."""
        rng, played = np.random.default_rng((self.seed, 0x60D, step)), self.played
        rows = [group[int(rng.integers(len(group)))] for group in (self.groups[int(i)] for i in self._starts(rng))]
        decisions = rng.integers(played.joints.shape[1], size=len(rows)).tolist()
        images = np.stack([played.images[row, d] for row, d in zip(rows, decisions, strict=True)])
        if self.shake is not None and images.shape[1]:
            images = shaken(images, self.shake, rng)
        seen = self.about.seen(played.joints[rows, decisions], images, played.state[rows, decisions])
        steps = np.array(decisions)[:, None] * self.about.stride + np.arange(self.about.chunk)
        last = played.actions.shape[1] * self.about.stride - 1
        actions = played.actions[rows].flatten(1, 2)[np.arange(len(rows))[:, None], np.minimum(steps, last)]
        valid = played.valid[rows].flatten(1, 2)[np.arange(len(rows))[:, None], np.minimum(steps, last)]
        return seen, actions, valid & torch.from_numpy(steps <= last), torch.Generator().manual_seed(int(rng.integers(2**62)))

    def _starts(self, rng: np.random.Generator) -> np.ndarray:
        return rng.integers(len(self.groups), size=self.batch)
