"""Rl: the policy learns from its own trials that went better or worse; the weights that do best on held-out starts are kept."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch

from edream import catalog
from edream.calibration.settings import RobotSettings, SpaceSettings
from edream.core.errors import require
from edream.core.stage import Artifact, Bundle, Source, Stage, Work
from edream.ingest.stored import stored_episodes
from edream.learn.checkpoint import weights_digest
from edream.learn.determinism import deterministic
from edream.learn.device import acting_on, device_of
from edream.learn.preference import Preference
from edream.learn.training import AVERAGE, Ahead, new_state, part, train
from edream.practice.about import ABOUT, HISTORY, WEIGHTS, PolicyAbout
from edream.practice.collecting import Manner, Player, collected, outcomes_of
from edream.practice.demonstrations import ChunkBatches
from edream.practice.dreaming import eyes_of
from edream.practice.imitating import Successes
from edream.practice.learning import Drawn, Lessons, Played, RlOptions, reference_of, shall_stop
from edream.practice.options import PolicyOptions, SftOptions
from edream.practice.ranking import why_no_pairs
from edream.practice.rehearsing import RolloutOptions, calm, cell_of, needs_of, physics_for, shards_of, sources_of
from edream.practice.sampling import demonstrations, held_out, scenes_of, with_twins
from edream.vision.variants import DreamOptions


@dataclass(frozen=True)
class RlPolicy(PolicyOptions):
    """The policy, and how it learns from trials.

    Attributes:
        rl: entry of `edream/preferences/`.
    """

    rl: str = "natural"


@dataclass(frozen=True)
class RlConfig:
    """What rl reads."""

    robot: RobotSettings
    task: str
    policy: RlPolicy
    sft: SftOptions
    rl: RlOptions
    fit: SpaceSettings
    rollouts: RolloutOptions
    dream: DreamOptions
    seed: int

    def __post_init__(self) -> None:
        catalog.load("preferences", self.policy.rl, Preference)
        learned = "at least 1 for a policy that learned from trials; evaluate.of=[sft] judges the supervised one alone"
        require(self.rl.rounds >= 1, "rl.rounds", self.rl.rounds, learned)
        seen, eyes = self.policy.cameras, f"for rollouts.eyes={self.rollouts.eyes}"
        if self.rollouts.eyes in ("composite", "dreamed") and seen is not None:
            require(len(seen) == 1, "policy.cameras", list(seen), f"one camera {eyes}")
        if self.rollouts.eyes == "state":
            require(seen == (), "policy.cameras", "null" if seen is None else list(seen), f"[] {eyes}")


def needs(config: RlConfig) -> tuple[str, ...]:
    """The trials and their ranks, the policy that training began with, and what trials of held-out starts need."""
    twins = ("twins",) if config.sft.twins else ()
    return ("ingest", "sft", "rollouts", "rank", *twins, *needs_of(config.rollouts))


def run(inputs: Mapping[str, Artifact], config: RlConfig, work: Work) -> Bundle:
    """Learn in pieces that are kept, try held-out starts after each, keep the best."""
    rolled, pairs = inputs["rollouts"], len(inputs["rank"]["pairs.parquet"])
    about = PolicyAbout.of(rolled[ABOUT])
    pieces = _learned(inputs, about, config, work) if pairs else []
    tried = _tried(pieces, rolled, about, inputs, config, work)
    best = max(range(len(tried)), key=lambda i: (tried[i]["success"], -tried[i]["distance_m"], -i))
    weights = rolled[WEIGHTS] if best == 0 else pieces[best - 1][WEIGHTS]
    told = [row for one in pieces for row in one["told.json"]["steps"]]
    round_, success = config.rl.rounds, rolled["summary.json"]["success"]
    row = {
        "round": round_,
        "trials": success["trials"],
        "pairs": pairs,
        "trial_success": success["share"],
        "steps": len(told),
        "stopped": bool(pieces and pieces[-1]["told.json"]["stop"]),
        "kept_step": 0 if best == 0 else pieces[best - 1]["told.json"]["step"],
        "before": tried[0],
        "kept": tried[best],
        "chosen": told[-1]["chosen"] if told else None,
        "rejected": told[-1]["rejected"] if told else None,
    }
    first, last = (100 * tried[number]["success"] for number in (0, best))
    held = f"success on held-out starts in the simulator from {first:.0f} % to {last:.0f} %."
    said = held if pairs else why_no_pairs(success["successes"], success["trials"])
    summary = {
        "sentence": f"Round {round_} of {config.policy.rl}: {said}",
        **row,
        "weights_digest": weights_digest(weights),
    }
    history = [*rolled[HISTORY], row]
    return {
        WEIGHTS: weights,
        ABOUT: rolled[ABOUT],
        HISTORY: history,
        "losses.json": told,
        "tried.json": tried,
        "summary.json": summary,
    }


def _learned(inputs: Mapping[str, Artifact], about: PolicyAbout, config: RlConfig, work: Work) -> Sequence[Artifact]:
    """The pieces of a round that has something to learn from."""
    rolled, ranking, options = inputs["rollouts"], inputs["rank"], config.rl
    played = Played.of([rolled[name] for name in sorted(name for name in rolled if name.startswith("trials/"))], about)
    ranks, device = ranking["ranks.parquet"], device_of(config.policy.device, "policy.device")
    with deterministic():
        against = rolled if catalog.load("preferences", config.policy.rl, Preference).region else inputs["sft"]
        still = about.network(_tensors(against[WEIGHTS])).to(device)
        reference = reference_of(still, played, about, device)
        lessons = Lessons(config.policy.rl, options, played, reference, ranks, ranking["pairs.parquet"], config.seed)
        successes = Successes.of(played, ranks, about, config.sft.batch, config.seed, options.shake)
        return _trained(about, lessons, (_demonstrations(inputs, about, config, work), successes), rolled, config, work)


def _trained(
    about: PolicyAbout,
    lessons: Lessons,
    shown: tuple[ChunkBatches, Successes],
    rolled: Artifact,
    config: RlConfig,
    work: Work,
) -> Sequence[Artifact]:
    """Every piece of the round until the stopping rule holds, each from where the last one ended."""
    options, device = config.rl, device_of(config.policy.device, "policy.device")
    network = about.network(_tensors(rolled[WEIGHTS])).to(device)
    demonstrated, done = shown
    imitated: list[tuple[float, ChunkBatches | Successes]] = []
    if options.demonstrations:
        imitated.append((options.demonstrations, demonstrated))
    if options.successes and done.groups:
        imitated.append((options.successes, done))

    def batches_of(step: int) -> tuple[Drawn, list[Any]]:
        return lessons.at(step, about), [batches.at(step) for _, batches in imitated]

    def loss_of(step: int, ahead: Ahead[tuple[Drawn, list[Any]]]) -> torch.Tensor:
        drawn, more = ahead.at(step)
        torch.manual_seed(config.seed * 1_000_003 + step)  # of dropout
        value = lessons.loss(network, about, drawn, device)
        for (weight, _), (seen, actions, valid, chance) in zip(imitated, more, strict=True):
            value = value + weight * network.loss(seen.to(device), actions.to(device), valid.to(device), chance)
        return value

    pieces: list[Artifact] = []
    for first in range(0, options.train.steps, options.checkpoint):
        last = min(first + options.checkpoint, options.train.steps)

        def piece(before: Artifact | None, rng: np.random.Generator, first: int = first, last: int = last) -> Bundle:
            begun = new_state(network) if before is None else before["state.safetensors"]
            lessons.told.clear()
            with torch.random.fork_rng(devices=[]), Ahead(batches_of, last) as ahead:
                state, _ = train(network, partial(loss_of, ahead=ahead), begun, first, last, options.train)
            told = {"step": last, "steps": list(lessons.told), "stop": shall_stop(lessons.told, lessons.entry, options.slack)}
            kept = {name: value.numpy() for name, value in part(state, AVERAGE).items()}
            return {"state.safetensors": state, WEIGHTS: kept, "told.json": told}

        pieces.append(work.shards(f"train-{first:07d}", [pieces[-1] if pieces else None], piece, parallel=False)[0])
        if pieces[-1]["told.json"]["stop"]:
            break
    return pieces


def _tried(
    pieces: Sequence[Artifact],
    rolled: Artifact,
    about: PolicyAbout,
    inputs: Mapping[str, Artifact],
    config: RlConfig,
    work: Work,
) -> list[dict[str, Any]]:
    """Held-out starts under the weights that the round began with and those after each piece; nothing is left to chance."""
    options, robot = calm(config.rollouts), config.robot.load()
    (physics,) = physics_for(robot, inputs, config.fit, options, work.folder("hooks"), config.seed)
    cell = cell_of(robot, physics, config.task, about, options, inputs)
    shards = shards_of([cell], range(config.rl.first, config.rl.first + config.rl.held), 1, options.shard)
    manner = Manner(seed=config.seed, keep=False, eyes=eyes_of(options, inputs, config.dream, config.seed))
    # what the round before kept was tried there on the same starts
    found = [{**rolled[HISTORY][-1]["kept"], "step": 0}] if rolled[HISTORY] else []
    tried = [(0, rolled.path(WEIGHTS)), *((one["told.json"]["step"], one.path(WEIGHTS)) for one in pieces)]
    for number, (step, path) in list(enumerate(tried))[len(found) :]:
        player = Player(path, rolled[ABOUT], acting_on(config.policy.device))
        outcomes = outcomes_of(collected(work, f"held-{number}", player, shards, manner))
        distance = float(outcomes["distance"].to_numpy().mean())
        found.append({"step": step, "success": float(np.mean(outcomes["success"].to_pylist())), "distance_m": distance})
    return found


def _demonstrations(inputs: Mapping[str, Artifact], about: PolicyAbout, config: RlConfig, work: Work) -> ChunkBatches:
    """The demonstrations that supervised training saw."""
    episodes = list(stored_episodes(inputs["ingest"])) if config.rl.demonstrations else []
    folder: Path = work.folder("images")
    if not episodes:
        return ChunkBatches([], about, config.sft.batch, config.seed)
    made, _, _ = demonstrations(episodes, about.order, config.policy, folder)
    held = held_out(len(made), config.sft.held, config.seed)
    twins, sft = inputs.get("twins"), config.sft
    taught = with_twins([(n, one) for n, one in enumerate(made) if n not in held], twins, folder)
    scenes = scenes_of(twins, sft)
    return ChunkBatches(taught, about, sft.batch, config.seed, sft.shake, hidden=sft.hidden, scenes=scenes)


def _tensors(weights: Mapping[str, np.ndarray]) -> dict[str, torch.Tensor]:
    return {name: torch.from_numpy(np.array(array)) for name, array in weights.items()}


def sources(config: RlConfig) -> Mapping[str, Source]:
    found: dict[str, Any] = {"robot": config.robot.content(), **sources_of(config.rollouts)}
    if config.sft.change.folder is not None:
        found["change"] = config.sft.change.folder
    return found | ({"objects": config.policy.objects} if config.policy.objects else {})


ENTRY = Stage("rl", 3, needs, RlConfig, run, sources, ("mujoco", "torch", "numpy"))
