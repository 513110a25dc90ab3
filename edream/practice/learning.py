"""One round of learning from ranked trials: what a step looks at, and the loss."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import pyarrow as pa
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from edream import catalog
from edream.core.errors import require
from edream.learn.policy import FittedPolicy, Seen, log_likelihood
from edream.learn.preference import Judged, Preference, PreferenceOptions
from edream.learn.training import Schedule
from edream.practice.about import PolicyAbout
from edream.practice.shaking import Shake, shaken


@dataclass(frozen=True)
class RlOptions:
    """One round of learning; see `conf/rl/default.yaml` for each.

    Attributes:
        rounds: how often trials are played, ranked and learned from.
        train: how long and how fast a round learns.
        objective: beta, alpha, clip.
        likelihood: laplace or gaussian.
        batch: pairs a step, or starts for objectives that learn from whole groups.
        demonstrations: weight of the supervised loss on the demonstrations beside it.
        successes: weight of the same loss on the trials that succeeded, each start counting the same.
        slack: how much less likely the chosen trials may become before a round stops [nats for each number executed].
        checkpoint: steps after which the stopping rule is asked, the state is kept and held-out starts are tried.
        held: held-out starts that decide which weights of a round are kept.
        first: number of the first held-out start.
        shake: how images are shaken.
    """

    rounds: int = 2
    train: Schedule = field(default_factory=Schedule)
    objective: PreferenceOptions = field(default_factory=PreferenceOptions)
    likelihood: str = "laplace"
    batch: int = 4
    demonstrations: float = 1.0
    successes: float = 1.0
    slack: float = 0.5
    checkpoint: int = 100
    held: int = 40
    first: int = 20000
    shake: Shake = field(default_factory=Shake)

    def __post_init__(self) -> None:
        require(self.rounds >= 0, "rl.rounds", self.rounds, "0 or more")
        require(self.likelihood in ("laplace", "gaussian"), "rl.likelihood", self.likelihood, "laplace or gaussian")
        for name in ("demonstrations", "successes", "slack"):
            require(getattr(self, name) >= 0.0, f"rl.{name}", getattr(self, name), "0 or more")
        for name in ("batch", "checkpoint", "held"):
            require(getattr(self, name) >= 1, f"rl.{name}", getattr(self, name), "at least 1")


@dataclass(frozen=True, eq=False)
class Played:
    """N trials as tensors: what was seen at each of D decisions and what was executed until the next.

    Attributes:
        joints, images, state: as recorded, SI and uint8, (N, D, ...).
        actions: normalised, (N, D, K, A), K the stride; the last repeated where the trial ends.
        valid: which of them were executed, (N, D, K).
    """

    joints: np.ndarray
    images: np.ndarray
    state: np.ndarray
    actions: Float[Tensor, "N D K A"]
    valid: Bool[Tensor, "N D K"]

    @classmethod
    def of(cls, shards: Sequence[Mapping[str, np.ndarray]], about: PolicyAbout) -> "Played":
        """From the arrays of all shards."""
        joints, actions = (np.concatenate([one[name] for one in shards]) for name in ("joints", "actions"))
        count, decisions = joints.shape[:2]
        blank = np.zeros((count, decisions, 0, about.shape.height, about.shape.width, 3), np.uint8)
        images = np.concatenate([one["images"] for one in shards]) if about.cameras else blank
        state = np.concatenate([one["state"] for one in shards]) if about.shape.state else np.zeros((count, decisions, 0))
        rows = about.stride * np.arange(decisions)[:, None] + np.arange(about.stride)
        valid = np.broadcast_to(rows < actions.shape[1], (count, *rows.shape)).copy()
        executed = about.actions.into(actions[:, np.minimum(rows, actions.shape[1] - 1)])
        return cls(joints, images, state, torch.from_numpy(executed), torch.from_numpy(valid))

    def __len__(self) -> int:
        return len(self.joints)

    def seen(
        self, rows: Sequence[int], about: PolicyAbout, shake: Shake | None = None, rng: np.random.Generator | None = None
    ) -> Seen:
        """What some trials saw, decisions one after the other, (N D, ...)."""
        images = np.concatenate([self.images[row] for row in rows])
        if shake is not None and rng is not None and images.shape[1]:
            images = shaken(images, shake, rng)
        return about.seen(np.concatenate([self.joints[r] for r in rows]), images, np.concatenate([self.state[r] for r in rows]))


def likelihoods(
    network: FittedPolicy, played: Played, rows: Sequence[int], seen: Seen, about: PolicyAbout, kind: str
) -> tuple[Float[Tensor, "N"], Float[Tensor, "N"], Float[Tensor, "N"]]:
    """Log-likelihood of what was executed under z = 0, the sum of |a - mu| / b over it, and how many numbers that is."""
    mean = network.chunk(seen)[:, : about.stride].unflatten(0, (len(rows), -1))
    actions, valid = played.actions[list(rows)].to(mean.device), played.valid[list(rows)].to(mean.device)
    off = ((actions - mean).abs() * valid[..., None]).flatten(1).sum(dim=1) / about.spread
    size = valid.flatten(1).sum(dim=1).to(mean.dtype) * mean.shape[-1]
    return log_likelihood(actions, mean, valid, about.spread, kind), off, size


@torch.no_grad()
def reference_of(network: FittedPolicy, played: Played, about: PolicyAbout, kind: str, device: torch.device) -> Float[Tensor, "N"]:
    """Log-likelihood of every trial under the policy that training began with."""
    network.eval()
    found = []
    for row in range(len(played)):
        found.append(likelihoods(network, played, [row], played.seen([row], about).to(device), about, kind)[0].cpu())
    return torch.cat(found)


class Lessons:
    """The loss of each step of a round; a batch follows from the seed and the step's number alone.

    Args:
        name: entry of `edream/preferences/`.
        reference: of each trial, from `reference_of`.
        ranks, pairs: as the stage rank made them.

    Attributes:
        told: of each step so far: log-ratios of chosen and rejected trials and the objective's loss.
    """

    def __init__(
        self, name: str, options: RlOptions, played: Played, reference: Tensor, ranks: pa.Table, pairs: pa.Table, seed: int
    ) -> None:
        self.entry, self.options, self.played, self.reference = (
            catalog.load("preferences", name, Preference),
            options,
            played,
            reference,
        )
        rows = sorted(ranks.to_pylist(), key=lambda row: row["trial"])
        self._advantage = torch.tensor([row["advantage"] for row in rows], dtype=torch.float32)
        self._good = torch.tensor([row["good"] for row in rows])
        self._pairs = [(row["chosen"], row["rejected"]) for row in pairs.to_pylist()]
        wanted = sorted({row["start"] for row in pairs.to_pylist()})
        self._groups = [[row["trial"] for row in rows if row["start"] == start] for start in wanted]
        self._seed = seed
        self.told: list[dict[str, float]] = []

    def loss(self, network: FittedPolicy, about: PolicyAbout, step: int, device: torch.device) -> Tensor:
        """The objective's loss of a step, in units of the mean error of one number, as a supervised loss beside it is."""
        rng = np.random.default_rng((self._seed, 0x9A1, step))
        rows, chosen, rejected = self._drawn(rng)
        seen = self.played.seen(rows, about, self.options.shake, rng).to(device)
        log, off, size = likelihoods(network, self.played, rows, seen, about, self.options.likelihood)
        judged = Judged(
            log - self.reference[rows].to(device),
            off,
            size,
            torch.tensor(chosen, device=device),
            torch.tensor(rejected, device=device),
            self._advantage[rows].to(device),
            self._good[rows].to(device),
        )
        value = self.entry.loss(judged, self.options.objective)
        ratio = judged.ratio.detach() / size
        self.told.append(
            {
                "loss": float(value.detach()),
                "chosen": float(ratio[judged.chosen].mean()),
                "rejected": float(ratio[judged.rejected].mean()),
            }
        )
        return value * about.spread / self.entry.steepness(judged, self.options.objective)

    def _drawn(self, rng: np.random.Generator) -> tuple[list[int], list[int], list[int]]:
        """Numbers of the trials of a batch, and the places in it of the better and the worse of each pair."""
        if self.entry.pairs:
            picked = [self._pairs[int(i)] for i in rng.integers(len(self._pairs), size=self.options.batch)]
            rows = [row for pair in picked for row in pair]
            return rows, list(range(0, len(rows), 2)), list(range(1, len(rows), 2))
        groups = [self._groups[int(i)] for i in rng.integers(len(self._groups), size=self.options.batch)]
        rows, chosen, rejected = [], [], []
        for group in groups:
            order = sorted(range(len(group)), key=lambda i: -float(self._advantage[group[i]]))
            chosen.append(len(rows) + order[0])
            rejected.append(len(rows) + order[-1])
            rows += group
        return rows, chosen, rejected


def shall_stop(told: Sequence[Mapping[str, float]], pairs: bool, slack: float) -> bool:
    """Whether a round has gone on too long: the chosen trials have become much less likely than they were under the reference.

    A little they always do: they were played by the policy that the round began with, so nothing makes them likelier than that one.
    """
    return pairs and float(np.mean([one["chosen"] for one in told])) < -slack
