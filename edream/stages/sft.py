"""Sft: a policy learns from demonstrations; the weights that do best on held-out ones are kept."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import torch

from edream.calibration.settings import RobotSettings
from edream.core.stage import Artifact, Bundle, Source, Stage, Work
from edream.ingest.stored import stored_episodes
from edream.learn.checkpoint import fill, weights_digest
from edream.learn.determinism import deterministic
from edream.learn.device import device_of
from edream.learn.policy import FittedPolicy, masked_l1
from edream.learn.training import AVERAGE, Ahead, new_state, part, train
from edream.practice.about import ABOUT, WEIGHTS, PolicyAbout
from edream.practice.demonstrations import ChunkBatches
from edream.practice.options import PolicyOptions, SftOptions
from edream.practice.sampling import about_of, demonstrations, held_out, with_twins


@dataclass(frozen=True)
class SftConfig:
    """What sft reads."""

    robot: RobotSettings
    policy: PolicyOptions
    sft: SftOptions
    seed: int


def run(inputs: Mapping[str, Artifact], config: SftConfig, work: Work) -> Bundle:
    """Train in pieces that are kept, judge each on the held-out demonstrations, keep the best."""
    order = config.robot.load().joints
    episodes = list(stored_episodes(inputs["ingest"]))
    folder = work.folder("images")
    made, cameras, rate = demonstrations(episodes, order, config.policy, folder)
    held = held_out(len(made), config.sft.held, config.seed)
    taught = [(number, one) for number, one in enumerate(made) if number not in held]
    about = about_of([one for _, one in taught], order, cameras, rate, config.policy)
    batches = ChunkBatches(with_twins(taught, inputs.get("twins"), folder), about, config.sft.batch, config.seed, config.sft.shake)
    judge = ChunkBatches([one for number, one in enumerate(made) if number in held], about, config.sft.batch, config.seed)
    with deterministic():
        pieces = _trained(about, batches, judge, config, work)
    curve = [{"step": one["told.json"]["step"], "l1": one["told.json"]["l1"]} for one in pieces]
    best = min(range(len(pieces)), key=lambda i: (curve[i]["l1"], i))
    weights = {name: value.numpy() for name, value in part(pieces[best]["state.safetensors"], AVERAGE).items()}
    about = replace(about, spread=max(float(curve[best]["l1"]), 1e-3))
    steps = sum(len(one) for _, one in taught)
    size = sum(array.size for array in weights.values())
    summary = {
        "sentence": f"{config.policy.kind} with {size / 1e6:.2f} M parameters learned from {len(taught)} demonstrations "
        f"({steps} steps); off by {curve[best]['l1']:.4f} spreads on {len(held)} held-out ones, best after step "
        f"{curve[best]['step']}.",
        "parameters": size,
        "demonstrations": len(taught),
        "heldout": sorted(made[number].name for number in held),
        "heldout_l1": curve[best]["l1"],
        "best_step": curve[best]["step"],
        "cameras": list(cameras),
        "rate": rate,
        "weights_digest": weights_digest(weights),
    }
    losses = [loss for one in pieces for loss in one["told.json"]["losses"]]
    return {WEIGHTS: weights, ABOUT: about.plain(), "summary.json": summary, "losses.json": {"train": losses, "heldout": curve}}


def _trained(about: PolicyAbout, batches: ChunkBatches, judge: ChunkBatches, config: SftConfig, work: Work) -> Sequence[Artifact]:
    """Every piece of the training, one after another, each from where the last one ended."""
    device = device_of(config.policy.device, "policy.device")
    network = about.network(seed=config.seed).to(device)
    schedule = config.sft.train

    def loss_of(step: int, ahead: Ahead[Any]) -> torch.Tensor:
        seen, actions, valid, chance = ahead.at(step)
        torch.manual_seed(config.seed * 1_000_003 + step)  # of dropout
        return network.loss(seen.to(device), actions.to(device), valid.to(device), chance)

    pieces: list[Artifact] = []
    for first in range(0, schedule.steps, config.sft.checkpoint):
        last = min(first + config.sft.checkpoint, schedule.steps)

        def piece(before: Artifact | None, rng: np.random.Generator, first: int = first, last: int = last) -> Bundle:
            begun = new_state(network) if before is None else before["state.safetensors"]
            with torch.random.fork_rng(devices=[]), Ahead(batches.at, last) as ahead:
                state, losses = train(network, partial(loss_of, ahead=ahead), begun, first, last, schedule)
            fill(network, part(state, AVERAGE), "The average")
            told = {"step": last, "losses": losses, "l1": heldout_l1(network, judge, config.sft, device)}
            return {"state.safetensors": state, "told.json": told}

        pieces.append(work.shards(f"train-{first:07d}", [pieces[-1] if pieces else None], piece, parallel=False)[0])
    return pieces


@torch.no_grad()
def heldout_l1(network: FittedPolicy, judge: ChunkBatches, options: SftOptions, device: torch.device) -> float:
    """Mean absolute error of z = 0 on held-out demonstrations, over steps that are no padding, in normalised units."""
    network.eval()
    places = judge.every(options.apart)
    total, count = 0.0, 0.0
    for first in range(0, len(places), 64):
        seen, actions, valid = judge.of(places[first : first + 64])
        weight = float(valid.sum())
        total += weight * float(masked_l1(network.chunk(seen.to(device)), actions.to(device), valid.to(device)))
        count += weight
    network.train()
    return total / max(count, 1.0)


def needs(config: SftConfig) -> tuple[str, ...]:
    """The recordings, and their twins where those are learned from too."""
    return ("ingest", "twins") if config.sft.twins else ("ingest",)


def sources(config: SftConfig) -> Mapping[str, Source]:
    """The robot, and the tracks of objects where the policy sees them."""
    found: dict[str, Any] = {"robot": config.robot.content()}
    return found | ({"objects": config.policy.objects} if config.policy.objects else {})


ENTRY = Stage("sft", 1, needs, SftConfig, run, sources, ("torch", "numpy"))
