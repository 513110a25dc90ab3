"""Sweep: what the simulator does under many parameter sets, on stretches of the recorded motions.

First Sobol points fill the whole box. Each simulated window also has its recording, so the sweep already tells which sets come near
it; later rounds draw their sets around those, where the surrogate has to be right.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import pyarrow as pa
from scipy.stats import qmc

from edream.calibration.data import rows_in
from edream.calibration.settings import RobotSettings, SpaceSettings, scored, simulated_robot, space_of
from edream.calibration.split import split_motions
from edream.calibration.sweeping import SETS, STEPS, from_tables, to_tables
from edream.calibration.windows import draw_windows, join, measured_sequences, simulate
from edream.core.episode import Episode
from edream.core.errors import require
from edream.core.stage import Artifact, Bundle, Source, Stage, Work
from edream.ingest.episode_read import read_episode
from edream.ingest.stored import stored_episodes, stored_index
from edream.sim.simulation import SimulatedRobot
from edream.sim.window import Window

NEAREST = 0.15  # share of the sets so far that the next round is drawn around


@dataclass(frozen=True)
class SweepSettings:
    """How much is simulated.

    Attributes:
        sets: parameter sets in the first round, a power of two; later rounds have half as many.
        rounds: how often the box is drawn closer around the sets that come nearest to the recordings.
        windows: stretches of the training motions.
        seconds: length of a stretch.
        blocks: into how many parts sets and windows are dealt; every set of a part meets every window of it.
    """

    sets: int = 128
    rounds: int = 3
    windows: int = 160
    seconds: float = 0.5
    blocks: int = 16

    def __post_init__(self) -> None:
        require(self.sets >= 2 and self.sets & (self.sets - 1) == 0, "sweep.sets", self.sets, "a power of two, 2 or more")
        for name in ("rounds", "windows", "blocks"):
            require(getattr(self, name) > 0, f"sweep.{name}", getattr(self, name), "1 or more")
        require(self.blocks <= self.sets, "sweep.blocks", self.blocks, f"no more than there are sets ({self.sets})")
        require(self.seconds > 0.0, "sweep.seconds", self.seconds, "seconds above 0")


@dataclass(frozen=True)
class SweepConfig:
    """What sweep reads."""

    robot: RobotSettings
    fit: SpaceSettings
    sweep: SweepSettings
    seed: int


def run(inputs: Mapping[str, Artifact], config: SweepConfig, work: Work) -> Bundle:
    """Simulate block by block, each kept on disk as soon as it is done; of all motions only the clocks are held at once."""
    ingested = inputs["ingest"]
    motions, held = split_motions([outline(episode) for episode in stored_episodes(ingested)], config.fit, config.seed)
    simulated = simulated_robot(config.robot.load(), config.fit, (*motions, *held))
    space_of(simulated)
    windows = windows_of(motions, config.sweep, work)
    files = {row.name: row.file for row in stored_index(ingested)}
    wanted = {w.episode.name for w in windows}
    read = {name: read_episode(ingested.path(f"episodes/{files[name]}")) for name in files if name in wanted}
    windows = [replace(w, episode=read[w.episode.name]) for w in windows]
    return sweep(simulated, windows, scored(simulated.robot, config.fit), config.sweep, work)


def outline(episode: Episode) -> Episode:
    """A motion of the same clock in which nothing moves, so that nothing but its clock takes memory: enough to choose stretches."""
    still = {name: np.broadcast_to(0.0, getattr(episode, name).shape) for name in ("position", "command")}
    bare = {"velocity": None, "effort": None, "enabled": None, "videos": {}, "signals": {}}
    return replace(episode, **still, **bare)


def windows_of(episodes: Sequence[Episode], options: SweepSettings, work: Work) -> list[Window]:
    """The stretches that are simulated; they follow from the motions' clocks alone."""
    rows = rows_in(episodes, options.seconds, most=40)
    return draw_windows(episodes, rows, options.windows, np.random.default_rng(work.seed("windows")))


def sweep(simulated: SimulatedRobot, windows: Sequence[Window], counted: np.ndarray, options: SweepSettings, work: Work) -> Bundle:
    """Round after round, closer around what comes near the recordings."""
    space = simulated.space
    dealt = [list(range(b, len(windows), options.blocks)) for b in range(options.blocks)]
    dealt = [numbers for numbers in dealt if numbers]
    unit = qmc.Sobol(len(space), rng=np.random.default_rng(work.seed("sobol"))).random(options.sets)
    parts, nearness, total = [], np.zeros((0, len(space) + 1)), 0
    for round_number in range(options.rounds):
        if round_number:
            unit = around(
                nearness, max(options.blocks, options.sets // 2), np.random.default_rng(work.seed(f"round {round_number}"))
            )
        sets = np.array_split(np.arange(len(unit)), len(dealt))
        items = [(unit[s], [windows[i] for i in w], total + s, w) for s, w in zip(sets, dealt, strict=True)]
        shards = work.shards(f"round {round_number}", items, partial(block, simulated=simulated), parallel="elsewhere")
        made = [from_tables(shard) for shard in shards]
        for one in made:
            nearness = np.concatenate([nearness, distances(simulated, one, windows, counted)])
        parts += made
        total += len(unit)
    table = to_tables(join(parts), space.names, simulated.robot.joints, space.from_unit(join(parts).unit))
    chosen = pa.table(
        {
            "window": pa.array(range(len(windows)), pa.int32()),
            "episode": pa.array([w.episode.name for w in windows]),
            "first": pa.array([w.first for w in windows], pa.int32()),
            "last": pa.array([w.last for w in windows], pa.int32()),
        }
    )
    simulations = sum(len(part) for part in parts)
    rows = table[STEPS].num_rows // max(1, simulations)
    summary = {
        "sentence": f"{total} parameter sets, {simulations} simulated windows of {rows} rows.",
        "sets": total,
        "simulations": simulations,
        "parameters": list(space.names),
    }
    return {SETS: table[SETS], STEPS: table[STEPS], "windows.parquet": chosen, "summary.json": summary}


def block(item: Any, rng: np.random.Generator, simulated: SimulatedRobot) -> Bundle:
    """Every set of one block on every window of it."""
    unit, windows, numbers, which = item
    made = simulate(simulated, unit, windows)
    made.which[:] = np.stack([numbers[made.which[:, 0]], np.array(which)[made.which[:, 1]]], axis=1)
    return to_tables(made, simulated.space.names, simulated.robot.joints, simulated.space.from_unit(made.unit))


def distances(simulated: SimulatedRobot, made: Any, windows: Sequence[Window], counted: np.ndarray) -> np.ndarray:
    """Each set of a block with the ratio of its error to the median set's, on the same windows, as the last column."""
    numbers = np.unique(made.which[:, 1])
    truth = {int(i): measured_sequences(simulated, [windows[i]]).position[0] for i in numbers}
    error = np.array([np.mean((p - truth[int(w)])[:, counted] ** 2) for p, w in zip(made.position, made.which[:, 1], strict=True)])
    sets = np.unique(made.which[:, 0])
    means = np.array([error[made.which[:, 0] == s].mean() for s in sets])
    first = np.array([np.flatnonzero(made.which[:, 0] == s)[0] for s in sets])
    return np.column_stack([made.unit[first], np.sqrt(means / np.median(means))])


def around(nearness: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """New sets around the nearest ones so far: one of them each, moved by as much as they differ among themselves."""
    order = np.argsort(nearness[:, -1], kind="stable")
    near = nearness[order[: max(8, int(NEAREST * len(order)))], :-1]
    spread = np.maximum(near.std(axis=0), 0.02)
    return np.clip(near[rng.integers(len(near), size=count)] + rng.normal(0.0, 0.7, (count, near.shape[1])) * spread, 0.0, 1.0)


def sources(config: SweepConfig) -> Mapping[str, Source]:
    return {"robot": config.robot.content()}


ENTRY = Stage(
    name="sweep", version=10, needs=("ingest",), config=SweepConfig, run=run, sources=sources, numerics=("mujoco", "scipy")
)
