"""Evaluate: how often each policy succeeds where it counts, in the stand-in reality, over starts that nothing was trained on."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import zip_longest
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pyarrow as pa

from edream import catalog
from edream.calibration.settings import RobotSettings
from edream.core.errors import EdreamError, require
from edream.core.stage import Artifact, Bundle, Source, Stage, Work
from edream.core.task import Task
from edream.ingest.episode_file import write_episode
from edream.learn.device import acting_on
from edream.practice.about import ABOUT, WEIGHTS, PolicyAbout, rounds_of
from edream.practice.collecting import OUTCOMES, Manner, Player, Shard, collected, outcomes_of, split
from edream.practice.film import episode_of, moving_picture
from edream.practice.naming import NAMES, brief, label
from edream.practice.options import Acting
from edream.practice.ranking import taught_nothing
from edream.practice.rates import Paired, Rate, apart, paired, rate
from edream.practice.rehearsing import require_task
from edream.reality.cell_look import CellLook
from edream.reality.truth import Truth, unseal
from edream.reality.workcell import RealWorkcell
from edream.sim.camera import graphics
from edream.sim.robot import RobotModel


@dataclass(frozen=True)
class EvaluateOptions:
    """How policies are judged; see `conf/evaluate/default.yaml` for each.

    Attributes:
        of: stages whose policies are judged; each may change settings, such as "sft policy.options.dim=32" or
            "rl rollouts.model=published".
        starts: trials of each.
        first: number of the first start.
        films: trials that are filmed.
        shard: trials that one process plays before it hands them in.
        paper: a sheet of A4 paper on the table that no demonstration has shown: none, horizontal or vertical.
        truth: the sealed truth of the robot; the one beside the recordings where None.
    """

    of: tuple[str, ...] = ("sft", "rl")
    starts: int = 200
    first: int = 30000
    films: int = 6
    shard: int = 10
    paper: Literal["none", "horizontal", "vertical"] = "none"
    truth: Path | None = None

    def __post_init__(self) -> None:
        good = bool(self.of) and all(one.split(" ")[0] in NAMES for one in self.of)
        require(good, "evaluate.of", list(self.of), "sft or rl, each with settings that differ where there are any")
        require(self.starts >= 1, "evaluate.starts", self.starts, "at least 1")
        require(self.films >= 0, "evaluate.films", self.films, "0 or more")
        require(self.shard >= 1, "evaluate.shard", self.shard, "at least 1")


@dataclass(frozen=True)
class EvaluateConfig:
    """What evaluate reads."""

    robot: RobotSettings
    task: str
    data: Path
    policy: Acting
    evaluate: EvaluateOptions
    seed: int

    @property
    def truth(self) -> Path:
        """Where the truth about the robot is sealed."""
        return self.evaluate.truth or self.data.with_name(self.data.name + ".truth.json")


def open_reality(robot: RobotModel, truth: Truth, task: str, rate: float, look: CellLook | None) -> RealWorkcell:
    """The stand-in for reality, for other processes."""
    with graphics():
        return RealWorkcell(robot, truth, catalog.load("tasks", task, Task), rate, look)


def run(inputs: Mapping[str, Artifact], config: EvaluateConfig, work: Work) -> Bundle:
    """Play every start with every policy, the same starts for all."""
    options, truth = config.evaluate, unseal(config.truth)
    robot, tables, rows = config.robot.load(), [], []
    films: dict[str, Any] = {}
    for number, name in enumerate(options.of):
        about = PolicyAbout.of(inputs[name][ABOUT])
        look = seen_by(about, replace(CellLook.of(truth.cameras), paper=options.paper))
        opener = partial(
            open_reality, RobotModel(robot.name, robot.mjcf, dict(robot.assets), robot.site), truth, config.task, about.rate, look
        )
        turns = [(options.first + number, 0) for number in range(options.starts)]
        player = Player(inputs[name].path(WEIGHTS), inputs[name][ABOUT], acting_on(config.policy.device))
        manner = Manner(seed=config.seed, keep=False)
        shards = [Shard(opener, piece) for piece in split(turns, options.shard)]
        outcomes = outcomes_of(collected(work, f"reality-{number}", player, shards, manner))
        tables.append(outcomes.append_column("policy", pa.array([name] * len(outcomes))))
        rows.append(row_of(name, about, outcomes))
        # played once more, which a deterministic world does alike
        again = [Shard(opener, ((start, 0),), (start,)) for start in worth_seeing(outcomes, options.films)]
        found = collected(work, f"films-{number}", player, again, manner) if again else []
        films |= filmed_trials(number, name, about, found, config.task, work.folder(f"films-{number}"))
    done = [table["success"].to_pylist() for table in tables]
    beside = paired(done[0], done[-1]) if len(done) > 1 else None
    idle = [f" {brief(row['name'])}: {said}" for row in rows if (said := taught_nothing(rounds_of(inputs[row["policy"]])))]
    summary = {
        "sentence": sentence(rows, beside) + "".join(idle),
        "task": config.task,
        "starts": options.starts,
        "rates": rows,
        "paired": beside,
    }
    return films | {"outcomes.parquet": pa.concat_tables(tables), "summary.json": summary}


def worth_seeing(outcomes: pa.Table, count: int) -> list[int]:
    """Starts to film: failures and successes in turn, the first of each, as far as there are any."""
    ways = [[row["start"] for row in outcomes.to_pylist() if row["success"] is way] for way in (False, True)]
    mixed = [start for pair in zip_longest(*ways) for start in pair if start is not None]
    return sorted(mixed[:count])


def filmed_trials(
    number: int, name: str, about: PolicyAbout, found: Sequence[Artifact], task: str, folder: Path
) -> dict[str, bytes | Path]:
    """Filmed trials of a policy: each a moving picture for the page, and an episode file for Foxglove."""
    made: dict[str, bytes | Path] = {}
    for shard in found:
        for file in sorted(one for one in shard if one.startswith("film-")):
            film, start = shard[file], int(Path(file).stem.removeprefix("film-"))
            good = next(row["success"] for row in shard[OUTCOMES] if row["start"] == start)
            notes = {"task": task, "policy": label(name), "start": str(start), "outcome": "success" if good else "failure"}
            path = folder / f"{start:08d}.mcap"
            write_episode(episode_of(film, f"{label(name)}, start {start}", about.order, about.rate, notes), path)
            made[f"films/{number}-{start:08d}.mcap"] = path
            picture = moving_picture(film, about.rate)
            if picture:
                made[f"films/{number}-{start:08d}.png"] = picture
    return made


def seen_by(about: PolicyAbout, look: CellLook) -> CellLook | None:
    """The cameras that a policy needs, as they recorded the demonstrations."""
    return replace(look, cameras=about.cameras) if about.cameras else None


def row_of(name: str, about: PolicyAbout, outcomes: pa.Table) -> dict[str, Any]:
    """A policy's line of the table: rates with their intervals, and the distance to the target in the median, as a thing that
    falls off the bench may come to rest metres away."""
    grasped = [one for one in outcomes["grasped"].to_pylist() if one is not None]
    views = f"{len(about.cameras)} view{'s' if len(about.cameras) != 1 else ''}" if about.cameras else "no camera"
    return {
        "name": f"{label(name)}, {views}",
        "policy": name,
        "success": rate(outcomes["success"].to_pylist()),
        "grasp": rate(grasped) if grasped else None,
        "distance_m": float(np.median(outcomes["distance"].to_numpy())),
    }


def sentence(rows: Sequence[Mapping[str, Any]], beside: Paired | None = None) -> str:
    """The rates, and whether the first and the last can be told apart: by their intervals, and start by start."""
    told = ", ".join(f"{brief(row['name'])} {_percent(row['success'])}" for row in rows)
    text = f"Success in the stand-in reality over {rows[0]['success'].trials} starts: {told}."
    if len(rows) > 1:
        which = "The intervals" if len(rows) == 2 else "The first interval and the last"
        clear = apart(rows[0]["success"], rows[-1]["success"])
        text += f" {which} do not overlap." if clear else f" {which} overlap: this many starts do not tell the two apart."
    if beside is not None:
        one, other = brief(rows[0]["name"]), brief(rows[-1]["name"])
        text += f" {beside.first} starts were done by {one} alone, {beside.second} by {other} alone (p = {beside.chance:.2g})."
    return text


def _percent(one: Rate) -> str:
    return f"{100 * one.share:.1f} % [{100 * one.interval[0]:.1f}, {100 * one.interval[1]:.1f}]"


def needs(config: EvaluateConfig) -> tuple[str, ...]:
    """The policies that are judged."""
    return tuple(config.evaluate.of)


def sources(config: EvaluateConfig) -> Mapping[str, Source]:
    """The robot and the sealed truth.

    Raises:
        EdreamError: there is no such task, or the truth is not there, as where the recordings are of a real robot.
    """
    require_task(config.task, config.robot.load())
    if not config.truth.is_file():
        raise EdreamError(
            f"There is no sealed truth at {config.truth}, so there is no stand-in reality to play in; give evaluate.truth=PATH. "
            "For a robot of your own write the policy with edream export-policy and run it there."
        )
    return {"robot": config.robot.content(), "truth": config.truth}


ENTRY = Stage("evaluate", 3, needs, EvaluateConfig, run, sources, ("mujoco", "torch", "numpy", "scipy"))
