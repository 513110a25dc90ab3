"""One round of learning from ranked trials: what a step looks at, and the loss."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

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


@dataclass(frozen=True, kw_only=True)
class RlOptions:
    """One round of learning; see `conf/rl/default.yaml` for each, and for the values.

    Attributes:
        rounds: how often trials are played, ranked and learned from.
        train: how long and how fast a round learns.
        objective: beta, alpha, clip.
        likelihood: laplace or gaussian.
        batch: what a step looks at: decisions, pairs of trials, or starts with all of their trials, as the objective has it; as
            many as suit it where None.
        demonstrations: weight of the supervised loss on the demonstrations beside it.
        successes: weight of the same loss on the trials that succeeded, each start counting the same.
        slack: how much less likely the chosen trials may become before a round stops [nats for each number executed].
        checkpoint: steps after which the stopping rule is asked, the state is kept and held-out starts are tried.
        held: held-out starts that decide which weights of a round are kept.
        first: number of the first held-out start.
        shake: how images are shaken.
    """

    rounds: int
    train: Schedule = field(default_factory=Schedule)
    objective: PreferenceOptions = field(default_factory=PreferenceOptions)
    likelihood: str = "laplace"
    batch: int | None = None
    demonstrations: float
    successes: float
    slack: float = 0.5
    checkpoint: int
    held: int
    first: int = 20000
    shake: Shake = field(default_factory=Shake)

    def __post_init__(self) -> None:
        require(self.rounds >= 0, "rl.rounds", self.rounds, "0 or more")
        require(self.likelihood in ("laplace", "gaussian"), "rl.likelihood", self.likelihood, "laplace or gaussian")
        for name in ("demonstrations", "successes", "slack"):
            require(getattr(self, name) >= 0.0, f"rl.{name}", getattr(self, name), "0 or more")
        require(self.batch is None or self.batch >= 1, "rl.batch", self.batch, "at least 1, or null")
        for name in ("checkpoint", "held"):
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
        self, places: "Places", about: PolicyAbout, shake: Shake | None = None, rng: np.random.Generator | None = None
    ) -> Seen:
        """What was seen at some decisions, (B, ...)."""
        images = self.images[places.trials, places.decisions]
        if shake is not None and rng is not None and images.shape[1]:
            images = shaken(images, shake, rng)
        return about.seen(self.joints[places.trials, places.decisions], images, self.state[places.trials, places.decisions])


@dataclass(frozen=True, eq=False)
class Places:
    """B decisions of trials: number of the trial and of the decision in it, (B,) each."""

    trials: np.ndarray
    decisions: np.ndarray

    @classmethod
    def whole(cls, trials: Sequence[int], played: Played) -> "Places":
        """Every decision of some trials, one trial after the other."""
        count = played.joints.shape[1]
        return cls(np.repeat(np.array(trials, dtype=int), count), np.tile(np.arange(count), len(trials)))


@dataclass(frozen=True, eq=False)
class Meant:
    """What a policy means to do at B decisions until the next, beside what was executed.

    Attributes:
        mean: normalised, (B, K, A).
        actions: what was executed, likewise.
        valid: which steps of it there were, (B, K).
    """

    mean: Float[Tensor, "B K A"]
    actions: Float[Tensor, "B K A"]
    valid: Bool[Tensor, "B K"]

    @classmethod
    def of(cls, network: FittedPolicy, played: Played, places: Places, seen: Seen, about: PolicyAbout) -> "Meant":
        """Under z = 0."""
        mean = network.chunk(seen)[:, : about.stride]
        actions, valid = (one[places.trials, places.decisions].to(mean.device) for one in (played.actions, played.valid))
        return cls(mean, actions, valid)

    def likelihood(self, scale: float, kind: str) -> Float[Tensor, "B"]:
        """Log-likelihood of what was executed."""
        return log_likelihood(self.actions, self.mean, self.valid, scale, kind)

    def sum(self, values: Float[Tensor, "B K A"]) -> Float[Tensor, "B"]:
        """Over all that was executed."""
        return (values * self.valid[..., None]).flatten(1).sum(dim=1)


@torch.no_grad()
def reference_of(network: FittedPolicy, played: Played, about: PolicyAbout, device: torch.device) -> Float[Tensor, "N D K A"]:
    """What a policy that stays as it is means to do at every decision of every trial."""
    network.eval()
    found = []
    for row in range(len(played)):
        places = Places.whole([row], played)
        found.append(Meant.of(network, played, places, played.seen(places, about).to(device), about).mean.cpu())
    return torch.stack(found)


@dataclass(frozen=True, eq=False)
class Drawn:
    """What a step looks at.

    Attributes:
        trials: the trial of each row of the loss.
        places: the decisions, those of whole trials or one a row.
        chosen, rejected: rows that did better, and those that did worse.
        seen: at each decision, shaken.
    """

    trials: list[int]
    places: Places
    chosen: list[int]
    rejected: list[int]
    seen: Seen


class Lessons:
    """The loss of each step of a round; a batch follows from the seed and the step's number alone.

    Args:
        name: entry of `edream/preferences/`.
        reference: from `reference_of`.
        ranks, pairs: as the stage rank made them.

    Attributes:
        told: of each step so far: log-ratios of better and worse trials, a number, and the objective's loss.
    """

    def __init__(
        self, name: str, options: RlOptions, played: Played, reference: Tensor, ranks: pa.Table, pairs: pa.Table, seed: int
    ) -> None:
        self.entry = catalog.load("preferences", name, Preference)
        self.options, self.played, self.reference = options, played, reference
        rows = sorted(ranks.to_pylist(), key=lambda row: row["trial"])
        self._advantage = torch.tensor([row["advantage"] for row in rows], dtype=torch.float32)
        self._good = torch.tensor([row["good"] for row in rows])
        self._pairs = [(row["chosen"], row["rejected"]) for row in pairs.to_pylist()]
        wanted = sorted({row["start"] for row in pairs.to_pylist()})
        self._groups = [[row["trial"] for row in rows if row["start"] == start] for start in wanted]
        self._telling = np.array([trial for group in self._groups for trial in group if self._advantage[trial] != 0.0], dtype=int)
        self._seed = seed
        self.told: list[dict[str, float]] = []

    def at(self, step: int, about: PolicyAbout) -> "Drawn":
        """What a step looks at; it follows from the seed and the step's number alone."""
        rng = np.random.default_rng((self._seed, 0x9A1, step))
        trials, places, chosen, rejected = self._drawn(rng)
        return Drawn(trials, places, chosen, rejected, self.played.seen(places, about, self.options.shake, rng))

    def loss(self, network: FittedPolicy, about: PolicyAbout, drawn: "Drawn", device: torch.device) -> Tensor:
        """The objective's loss of a step, in units of the mean error of one number, as a supervised loss beside it is."""
        trials, places, chosen, rejected = drawn.trials, drawn.places, drawn.chosen, drawn.rejected
        meant = Meant.of(network, self.played, places, drawn.seen.to(device), about)
        sums = self._sums(meant, replace(meant, mean=self.reference[places.trials, places.decisions].to(device)), about.spread)
        if len(trials) < len(places.trials):  # whole trials
            sums = {name: one.unflatten(0, (len(trials), -1)).sum(dim=1) for name, one in sums.items()}
        judged = Judged(
            chosen=torch.tensor(chosen, device=device, dtype=torch.long),
            rejected=torch.tensor(rejected, device=device, dtype=torch.long),
            advantage=self._advantage[trials].to(device),
            good=self._good[trials].to(device),
            **sums,
        )
        value = self.entry.loss(judged, self.options.objective)
        each = judged.ratio.detach() / judged.size
        told = {name: float(each[rows].mean()) if len(rows) else 0.0 for name, rows in (("chosen", chosen), ("rejected", rejected))}
        self.told.append({"loss": float(value.detach())} | told)
        return value * about.spread / self.entry.steepness(judged, self.options.objective)

    def _sums(self, meant: Meant, before: Meant, scale: float) -> dict[str, Tensor]:
        """What `Judged` has of each decision."""
        kind, step, chance = self.options.likelihood, meant.mean - before.mean, meant.actions - before.mean
        return {
            "ratio": meant.likelihood(scale, kind) - before.likelihood(scale, kind),
            "error": meant.sum((meant.actions - meant.mean).abs()) / scale,
            "size": meant.sum(torch.ones_like(meant.mean)),
            "chance": meant.sum(chance.abs()) / scale,
            "moved": meant.sum(step**2) / scale**2,
            "towards": meant.sum(step * chance) / scale**2,
        }

    def _drawn(self, rng: np.random.Generator) -> tuple[list[int], Places, list[int], list[int]]:
        """The trial of each row of a batch, the decisions it looks at, and which rows are better and worse ones."""
        size = self.options.batch or self.entry.batch
        if self.entry.looks_at == "decisions":
            trials = self._telling[rng.integers(len(self._telling), size=size)]
            places = Places(trials, rng.integers(self.played.joints.shape[1], size=size))
            gain = self._advantage[trials].numpy()
            return trials.tolist(), places, np.flatnonzero(gain > 0).tolist(), np.flatnonzero(gain < 0).tolist()
        rows, chosen, rejected = [], [], []
        if self.entry.looks_at == "pairs":
            rows = [row for i in rng.integers(len(self._pairs), size=size) for row in self._pairs[int(i)]]
            chosen, rejected = list(range(0, len(rows), 2)), list(range(1, len(rows), 2))
        else:
            for group in [self._groups[int(i)] for i in rng.integers(len(self._groups), size=size)]:
                order = sorted(range(len(group)), key=lambda i: -float(self._advantage[group[i]]))
                chosen.append(len(rows) + order[0])
                rejected.append(len(rows) + order[-1])
                rows += group
        return rows, Places.whole(rows, self.played), chosen, rejected


def shall_stop(told: Sequence[Mapping[str, float]], entry: Preference, slack: float) -> bool:
    """Whether a round has gone on too long: the chosen trials have become much less likely than they were under the reference.

    A little they always do: they were played by the policy that the round began with, so nothing makes them likelier than that one.
    Only of pairs is this asked; a trust region ends by itself.
    """
    return entry.looks_at == "pairs" and float(np.mean([one["chosen"] for one in told])) < -slack
