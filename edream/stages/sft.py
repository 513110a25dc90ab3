"""Sft: a policy learns from demonstrations; the weights that do best on held-out ones are kept."""

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn

from edream import catalog
from edream.calibration.settings import RobotSettings
from edream.core.errors import EdreamError
from edream.core.stage import Artifact, Bundle, Source, Stage, Work
from edream.ingest.stored import stored_episodes
from edream.learn import ranks
from edream.learn.checkpoint import fill, read_weights, weights_digest
from edream.learn.determinism import deterministic
from edream.learn.device import device_of
from edream.learn.policy import FittedPolicy, Policy, Seen, masked_l1
from edream.learn.training import AVERAGE, Ahead, State, new_state, part, train
from edream.practice.about import ABOUT, WEIGHTS, PolicyAbout
from edream.practice.bundle import going_on
from edream.practice.demonstrations import ChunkBatches, Demonstration
from edream.practice.options import PolicyOptions, SftOptions
from edream.practice.sampling import about_of, demonstrations, held_out, scenes_of, with_twins


@dataclass(frozen=True)
class SftConfig:
    """What sft reads."""

    robot: RobotSettings
    policy: PolicyOptions
    sft: SftOptions
    seed: int

    def __post_init__(self) -> None:
        catalog.load("policies", self.policy.kind, Policy)


class Lesson(nn.Module):
    """A policy's training loss as a forward pass, which is where the gradients of several processes meet."""

    def __init__(self, network: FittedPolicy) -> None:
        super().__init__()
        self.network = network

    def forward(self, seen: Seen, actions: torch.Tensor, valid: torch.Tensor, chance: torch.Generator) -> torch.Tensor:
        return self.network.loss(seen, actions, valid, chance)


@dataclass(frozen=True, eq=False)
class Trainer:
    """All that trains the policy; every process that trains along has one.

    Attributes:
        taught: the demonstrations; `batches` of them and of their twins.
        judge: the held-out ones, whose names are `held`; and their twins, where scenes are changed.
    """

    config: SftConfig
    about: PolicyAbout
    network: FittedPolicy
    taught: tuple[Demonstration, ...]
    batches: ChunkBatches
    judge: ChunkBatches
    held: tuple[str, ...]

    @classmethod
    def of(cls, inputs: Mapping[str, Artifact], config: SftConfig, folder: Path) -> "Trainer":
        """With the demonstrations' images in files of `folder`."""
        order = config.robot.load().joints
        made, cameras, rate = demonstrations(list(stored_episodes(inputs["ingest"])), order, config.policy, folder)
        held = held_out(len(made), config.sft.held, config.seed)
        taught, kept = ([(n, one) for n, one in enumerate(made) if (n in held) is way] for way in (False, True))
        about, start = about_of([one for _, one in taught], order, cameras, rate, config.policy), config.sft.start
        about = about if start is None else going_on(about, start)
        weights = None if start is None else read_weights(start / WEIGHTS)
        twins = inputs.get("twins")
        scenes, size = scenes_of(twins, config.sft), config.sft.batch
        seen = with_twins(taught, twins, folder)
        batches = ChunkBatches(seen, about, size, config.seed, config.sft.shake, hidden=config.sft.hidden, scenes=scenes)
        # changed scenes are there to be met, so how a policy does in them counts, too
        judge = ChunkBatches(with_twins(kept, twins if scenes else None, folder), about, size, config.seed, scenes=scenes)
        network = about.network(weights, config.seed).to(device_of(config.policy.device, "policy.device"))
        names = tuple(sorted(made[number].name for number in held))
        return cls(config, about, network, tuple(one for _, one in taught), batches, judge, names)

    @cached_property
    def lesson(self) -> Lesson:
        """The loss of a step, compiled where that is asked for: once, for compiling is what costs."""
        lesson = Lesson(self.network)
        if self.config.sft.compile:
            lesson.compile()
        return lesson

    @property
    def number(self) -> int:
        """By which processes know that they train the same."""
        return zlib.crc32(repr(self.config).encode()) & 0x7FFFFFFF

    def piece(self, state: State, first: int, last: int, together: bool) -> tuple[State, list[float]]:
        """Steps `first` up to `last`, by all processes where `together`."""
        device = next(self.network.parameters()).device
        called = ranks.as_one(self.lesson) if together else self.lesson
        own = (ranks.rank(), ranks.world()) if together else (0, 1)
        batches = replace(self.batches, part=own)

        def loss_of(step: int, ahead: Ahead[Any]) -> torch.Tensor:
            seen, actions, valid, chance = ahead.at(step)
            torch.manual_seed(self.config.seed * 1_000_003 + step + (own[0] << 40))  # of dropout
            return called(seen.to(device), actions.to(device), valid.to(device), chance)

        with torch.random.fork_rng(devices=[]), Ahead(batches.at, last) as ahead:
            schedule = self.config.sft.train
            return train(self.network, partial(loss_of, ahead=ahead), state, first, last, schedule, together)


def run(inputs: Mapping[str, Artifact], config: SftConfig, work: Work) -> Bundle:
    """Train in pieces that are kept, judge each on the held-out demonstrations, keep the best."""
    if config.sft.batch % ranks.world():
        count = ranks.world()
        raise EdreamError(
            f"sft.batch is {config.sft.batch}, which {count} processes cannot share evenly; give a multiple of {count}."
        )
    with deterministic():
        trainer = Trainer.of(inputs, config, work.folder("images"))
        pieces = _trained(trainer, work)
    curve = [{name: value for name, value in one["told.json"].items() if name != "losses"} for one in pieces]
    best = min(range(len(pieces)), key=lambda i: (judged(curve[i], config.sft.hidden), i))
    weights = {name: value.numpy() for name, value in part(pieces[best]["state.safetensors"], AVERAGE).items()}
    about = replace(trainer.about, spread=max(float(curve[best]["l1"]), 1e-3))
    steps = sum(len(one) for one in trainer.taught)
    size = sum(array.size for array in weights.values())
    summary = {
        "sentence": f"{config.policy.kind} with {size / 1e6:.2f} M parameters learned from {len(trainer.taught)} demonstrations "
        f"({steps} steps); off by {curve[best]['l1']:.4f} spreads on {len(trainer.held)} held-out ones, best after step "
        f"{curve[best]['step']}.",
        "parameters": size,
        "demonstrations": len(trainer.taught),
        "heldout": list(trainer.held),
        "heldout_l1": curve[best]["l1"],
        "best_step": curve[best]["step"],
        "cameras": list(about.cameras),
        "rate": about.rate,
        "weights_digest": weights_digest(weights),
    }
    losses = [loss for one in pieces for loss in one["told.json"]["losses"]]
    return {WEIGHTS: weights, ABOUT: about.plain(), "summary.json": summary, "losses.json": {"train": losses, "heldout": curve}}


def _trained(trainer: Trainer, work: Work) -> Sequence[Artifact]:
    """Every piece of the training, one after another, each from where the last one ended."""
    options = trainer.config.sft
    pieces: list[Artifact] = []
    for first in range(0, options.train.steps, options.checkpoint):
        last = min(first + options.checkpoint, options.train.steps)

        def piece(before: Artifact | None, rng: np.random.Generator, first: int = first, last: int = last) -> Bundle:
            begun = dict(new_state(trainer.network) if before is None else before["state.safetensors"])
            together = ranks.led((trainer.number, first, last), begun)
            state, losses = trainer.piece(begun, first, last, together)
            fill(trainer.network, part(state, AVERAGE), "The average")
            device = next(trainer.network.parameters()).device
            told = {"step": last, "losses": losses, **heldout_l1(trainer.network, trainer.judge, options, device)}
            return {"state.safetensors": state, "told.json": told}

        pieces.append(work.shards(f"train-{first:07d}", [pieces[-1] if pieces else None], piece, parallel=False)[0])
    return pieces


def judged(point: Mapping[str, float], hidden: float) -> float:
    """The held-out error by which weights are kept: with joints and without, in the proportion of the training."""
    return point["l1"] if not hidden else (1.0 - hidden) * point["l1"] + hidden * point["hidden"]


def follow(inputs: Mapping[str, Artifact], config: SftConfig, folder: Path) -> None:
    """Train the pieces of the same training that the first process names, with it."""
    with deterministic():
        trainer = Trainer.of(inputs, config, folder)
        for _, first, last in ranks.orders(trainer.number):
            trainer.piece(ranks.followed(new_state(trainer.network)), first, last, together=True)


@torch.no_grad()
def heldout_l1(network: FittedPolicy, judge: ChunkBatches, options: SftOptions, device: torch.device) -> dict[str, float]:
    """Mean absolute error of z = 0 on held-out demonstrations, over steps that are no padding, in normalised units.

    Returns:
        "l1" with everything to be seen; where training hides joints also "hidden", the same without them: a policy may follow
        recorded joints and hardly look, which the first alone would reward.
    """
    network.eval()
    places, rng = judge.every(options.apart), np.random.default_rng((judge.seed, 0x5CE))  # of changed scenes, the same each time
    total, count = np.zeros(2), 0.0
    for first in range(0, len(places), 64):
        seen, actions, valid = judge.of(places[first : first + 64], rng)
        shown = [seen, seen.without_joints()] if options.hidden else [seen]
        weight = float(valid.sum())
        errors = [float(masked_l1(network.chunk(one.to(device)), actions.to(device), valid.to(device))) for one in shown]
        total += weight * np.array([errors[0], errors[-1]])
        count += weight
    network.train()
    plain, blind = total / max(count, 1.0)
    return {"l1": float(plain)} | ({"hidden": float(blind)} if options.hidden else {})


def needs(config: SftConfig) -> tuple[str, ...]:
    """The recordings, and their twins where those are learned from too."""
    return ("ingest", "twins") if config.sft.twins else ("ingest",)


def sources(config: SftConfig) -> Mapping[str, Source]:
    """The robot, and the tracks of objects where the policy sees them."""
    found: dict[str, Any] = {"robot": config.robot.content()}
    if config.policy.objects is not None:
        found["objects"] = config.policy.objects
    if config.sft.change.folder is not None:
        found["change"] = config.sft.change.folder
    if (start := config.sft.start) is not None:  # what is read of it, so that the same weights elsewhere train nothing anew
        found |= {"start weights": start / WEIGHTS, "start about": start / ABOUT}
    return found


ENTRY = Stage("sft", 2, needs, SftConfig, run, sources, ("torch", "numpy"), follow)
