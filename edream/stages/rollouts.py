"""Rollouts: the policy tries every start several times in the calibrated simulator, and some of it is left to chance."""

from collections.abc import Mapping
from dataclasses import dataclass

from edream.calibration.settings import RobotSettings, SpaceSettings
from edream.core.stage import Artifact, Bundle, Source, Stage, Work
from edream.learn.device import acting_on
from edream.practice.about import ABOUT, HISTORY, WEIGHTS, PolicyAbout, rounds_of
from edream.practice.collecting import TRIALS, Manner, Player, collected, outcomes_of
from edream.practice.dreaming import eyes_of
from edream.practice.options import Acting
from edream.practice.rates import rate
from edream.practice.rehearsing import RolloutOptions, cell_of, needs_of, physics_for, require_task, shards_of, sources_of
from edream.vision.variants import DreamOptions


@dataclass(frozen=True)
class Round:
    """Which round of learning the trials are for, from 1 on."""

    rounds: int


@dataclass(frozen=True)
class RolloutsConfig:
    """What rollouts reads."""

    robot: RobotSettings
    task: str
    policy: Acting
    fit: SpaceSettings
    dream: DreamOptions
    rollouts: RolloutOptions
    rl: Round
    seed: int


def needs(config: RolloutsConfig) -> tuple[str, ...]:
    """The policy, which is the supervised one or that of the round before, the physics, and what the eyes need."""
    return (policy_of(config), *needs_of(config.rollouts))


def policy_of(config: RolloutsConfig) -> str:
    """Whose trials these are."""
    return "sft" if config.rl.rounds <= 1 else f"rl rl.rounds={config.rl.rounds - 1}"


def run(inputs: Mapping[str, Artifact], config: RolloutsConfig, work: Work) -> Bundle:
    """Play all trials, in shards that other processes take."""
    options = config.rollouts
    source = inputs[policy_of(config)]
    about = PolicyAbout.of(source[ABOUT])
    robot = config.robot.load()
    drawn = physics_for(robot, inputs, config.fit, options, work.folder("hooks"), config.seed)
    cells = [cell_of(robot, physics, config.task, about, options, inputs) for physics in drawn]
    # starts differ from round to round, so that no round learns the starts of another by heart
    first = options.first + (config.rl.rounds - 1) * options.starts
    shards = shards_of(cells, range(first, first + options.starts), options.samples, options.shard)
    manner = Manner(options.noise, config.seed, True, eyes_of(options, inputs, config.dream, config.seed))
    found = collected(work, "trials", Player(source.path(WEIGHTS), source[ABOUT], acting_on(config.policy.device)), shards, manner)
    outcomes = outcomes_of(found)
    succeeded = rate(outcomes["success"].to_pylist())
    summary = {
        "sentence": f"Round {config.rl.rounds}: {len(outcomes)} trials of {options.starts} starts in the simulator ("
        f"{options.model}, {options.eyes}); {100 * succeeded.share:.0f} % succeeded.",
        "round": config.rl.rounds,
        "success": succeeded,
        "distance_m": float(outcomes["distance"].to_numpy().mean()),
        "physics": len(cells),
    }
    kept = {f"trials/{number:05d}.safetensors": shard.path(TRIALS) for number, shard in enumerate(found)}
    policy = {WEIGHTS: source[WEIGHTS], ABOUT: source[ABOUT], HISTORY: rounds_of(source)}
    return kept | policy | {"outcomes.parquet": outcomes, "summary.json": summary}


def sources(config: RolloutsConfig) -> Mapping[str, Source]:
    require_task(config.task, config.robot.load())
    return {"robot": config.robot.content(), **sources_of(config.rollouts)}


ENTRY = Stage("rollouts", 1, needs, RolloutsConfig, run, sources, ("mujoco", "torch", "numpy"))
