"""Trials in parallel: shards of starts, each in a process with a world of its own, the same numbers however many processes."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from edream.core.policy import Observation, World
from edream.core.stage import Artifact, Bundle, Work
from edream.learn.checkpoint import read_weights
from edream.learn.determinism import deterministic
from edream.learn.device import device_of
from edream.practice.about import PolicyAbout
from edream.practice.film import film_of
from edream.practice.trial import Chance, Eyes, OwnEyes, Trial, play

TRIALS, OUTCOMES = "trials.safetensors", "outcomes.json"


@dataclass(frozen=True)
class Player:
    """A policy that another process can read.

    Attributes:
        weights: a .safetensors file.
        about: what `PolicyAbout.plain` says.
        device: cpu or cuda.
    """

    weights: Path
    about: Mapping[str, Any]
    device: str = "cpu"


@dataclass(frozen=True)
class Shard:
    """What one process plays.

    Attributes:
        open: opens a world; a function of a module or a partial of one.
        turns: start and sample of each trial.
        filmed: starts of which a film is kept.
    """

    open: Callable[[], World]
    turns: tuple[tuple[int, int], ...]
    filmed: tuple[int, ...] = ()


@dataclass(frozen=True)
class Manner:
    """How trials are played.

    Attributes:
        chance: what is left to chance.
        seed: of chance.
        keep: whether what was seen and done is kept, for learning; else outcomes alone.
        eyes: makes the eyes; a function of a module or a partial of one.
    """

    chance: Chance = field(default_factory=Chance)
    seed: int = 0
    keep: bool = True
    eyes: Callable[[], Eyes] = OwnEyes


def collected(work: Work, name: str, player: Player, shards: Sequence[Shard], manner: Manner) -> Sequence[Artifact]:
    """Play all shards over the executor's processes; finished ones survive a kill."""
    return work.shards(name, shards, partial(played, player=player, manner=manner))


def played(shard: Shard, rng: np.random.Generator, *, player: Player, manner: Manner) -> Bundle:
    """Play one shard, on one thread: torch's sums depend on the number of threads, and a policy's numbers may not."""
    with deterministic(1):
        about = PolicyAbout.of(player.about)
        network = about.network(read_weights(player.weights)).eval().to(device_of(player.device, "policy.device"))
        world, eyes = shard.open(), manner.eyes()
        trials: list[Trial] = []
        films: dict[str, dict[str, np.ndarray]] = {}
        try:
            for start, sample in shard.turns:
                film: list[Observation] | None = [] if start in shard.filmed and sample == 0 else None
                trials.append(play(world, network, about, eyes, start, sample, manner.chance, manner.seed, film))
                if film:
                    films[f"film-{start:08d}.safetensors"] = film_of(film, trials[-1])
        finally:
            world.close()
    kept = packed(trials) if manner.keep else {}
    return ({TRIALS: kept} if kept else {}) | {OUTCOMES: [_told(trial) for trial in trials]} | films


def packed(trials: Sequence[Trial]) -> dict[str, np.ndarray]:
    """Trials as arrays, one row a trial."""
    parts = {
        "joints": np.stack([one.joints for one in trials]).astype(np.float32),
        "images": np.stack([one.images for one in trials]),
        "state": np.stack([one.state for one in trials]).astype(np.float32),
        "actions": np.stack([one.actions for one in trials]).astype(np.float32),
    }
    return {name: array for name, array in parts.items() if array.size}


def outcomes_of(shards: Sequence[Artifact]) -> pa.Table:
    """What became of every trial: trial (its number), start, sample, success, grasped, distance [m]."""
    rows = [row for shard in shards for row in shard[OUTCOMES]]
    kinds_ = [("trial", pa.int64()), ("start", pa.int64()), ("sample", pa.int64())]
    kinds_ += [("success", pa.bool_()), ("grasped", pa.bool_()), ("distance", pa.float64())]
    return pa.Table.from_pylist([{"trial": number} | row for number, row in enumerate(rows)], pa.schema(kinds_))


def _told(trial: Trial) -> dict[str, Any]:
    end = trial.outcome
    grasped = None if end.grasped is None else bool(end.grasped)
    return {
        "start": trial.start,
        "sample": trial.sample,
        "success": bool(end.success),
        "grasped": grasped,
        "distance": float(end.distance),
    }


def split(turns: Sequence[tuple[int, int]], size: int) -> list[tuple[tuple[int, int], ...]]:
    """Turns in pieces of a size that no number of processes changes."""
    return [tuple(turns[i : i + size]) for i in range(0, len(turns), size)]
