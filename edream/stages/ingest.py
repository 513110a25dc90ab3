"""Ingest: recordings of any supported format -> one checked MCAP file an episode, an index, and what was noticed."""

import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from edream.core.episode import Episode
from edream.core.format import Malformed, ReadOptions
from edream.core.stage import Artifact, Bundle, Source, Stage, Work
from edream.ingest.episode_file import write_episode
from edream.ingest.findings import Findings, summarise
from edream.ingest.mapping import MappingConfig
from edream.ingest.recordings import ingest_recordings
from edream.sim.robot import RobotModel, load_robot

EPISODE, MALFORMED, FOUND = "episode.mcap", "malformed.json", "found.json"


@dataclass(frozen=True)
class IngestOptions:
    """How recordings become episodes; see `conf/ingest/default.yaml` for each."""

    format: str | None = None
    strict: bool = False
    fps: float | None = None
    time: str | None = None
    command: tuple[str, ...] = ()
    position: tuple[str, ...] = ()
    colour: str = "rgb"
    command_shift: int = 0
    images: str = "png"
    mapping: MappingConfig = field(default_factory=MappingConfig)


@dataclass(frozen=True)
class IngestRobot:
    """Of the robot only its joints count here."""

    mjcf: Path


@dataclass(frozen=True)
class IngestConfig:
    """What ingest reads."""

    data: Path
    robot: IngestRobot
    ingest: IngestOptions


def sources(config: IngestConfig) -> Mapping[str, Source]:
    """The recordings with the small files beside them, and the robot's joints: other changes of its model change no episode."""
    data = config.data
    if data.name == "info.json" or data.name == "meta":
        data = data.parent.parent if data.name == "info.json" else data.parent
    beside = [*data.parent.glob("*.csv"), *data.parent.glob("*.json")] if data.is_file() else []
    robot = load_robot(config.robot.mjcf)
    joints = json.dumps({"joints": robot.joints, "ranges": joint_ranges(robot)}, sort_keys=True).encode()
    return {"data": data, "robot.joints": joints} | {f"beside/{path.name}": path for path in beside}


def joint_ranges(robot: RobotModel) -> dict[str, tuple[float, float]]:
    """Limits of the robot's limited joints [rad or m]."""
    model = robot.model
    limited = [name for name in robot.joints if model.joint(name).limited[0]]
    return {name: (float(model.joint(name).range[0]), float(model.joint(name).range[1])) for name in limited}


def run(inputs: Mapping[str, Artifact], config: IngestConfig, work: Work) -> Bundle:
    """Read, map and check the recordings one by one; each is kept as soon as it is written."""
    robot = load_robot(config.robot.mjcf)
    options = config.ingest
    found = ingest_recordings(
        config.data,
        robot.joints,
        ReadOptions(options.fps, options.time, options.command, options.position, options.colour, options.command_shift),
        options.mapping,
        strict=options.strict,
        format=options.format,
        ranges=joint_ranges(robot),
    )
    seen: list[Findings] = []

    def one(item: tuple[Episode, Findings] | Malformed, rng: np.random.Generator) -> Bundle:
        if isinstance(item, Malformed):
            return {MALFORMED: {"name": item.name, "reason": item.reason}}
        episode, findings = item
        path = work.folder("writing") / EPISODE
        write_episode(episode, path, provenance={"made by": "edream ingest"}, images=options.images)
        return {EPISODE: path, FOUND: _row(episode, findings)} | {f"{name}.png": data for name, data in findings.previews.items()}

    shards = work.shards("episodes", _noting(found, seen), one, parallel=False)
    return _bundle(list(shards), robot, summarise(seen))


def _noting(found: Iterator[tuple[Episode, Findings] | Malformed], seen: list[Findings]) -> Iterator[Any]:
    for item in found:
        if not isinstance(item, Malformed):
            seen.append(replace(item[1], previews={}))
        yield item


def _row(episode: Episode, findings: Findings) -> dict[str, Any]:
    return {
        "name": episode.name,
        "task": episode.notes.get("task", ""),
        "rows": len(episode.times),
        "commands": len(episode.command_times),
        "duration": episode.duration,
        "rate": findings.rate,
        "jitter": findings.jitter,
        "cameras": list(episode.videos),
        "conditions": dict(episode.conditions),
        "findings": list(findings.sentences()),
    }


def _bundle(shards: list[Artifact], robot: RobotModel, noticed: tuple[str, ...]) -> Bundle:
    bundle: dict[str, Any] = {}
    rows, malformed = [], []
    for shard in shards:
        if MALFORMED in shard:
            malformed.append(shard[MALFORMED])
            continue
        row = shard[FOUND]
        slug = re.sub(r"[^A-Za-z0-9_.-]+", "_", row["name"]).strip("._")[:80]
        file = f"episodes/{len(rows):06d}_{slug}.mcap"
        bundle[file] = shard.path(EPISODE)
        rows.append(row | {"file": file})
        if len(rows) == 1:
            bundle |= {f"preview/{name}": shard.path(name) for name in shard if name.endswith(".png")}
    lost = f"; {len(malformed)} malformed and left out" if malformed else ""
    bundle["summary.json"] = {
        "sentence": f"{len(rows)} episodes, {sum(row['duration'] for row in rows):.0f} s, {len(robot.joints)} joints{lost}.",
        "episodes": len(rows),
        "duration_s": sum(row["duration"] for row in rows),
        "joints": list(robot.joints),
        "noticed": list(noticed),
        "malformed": malformed,
        "index": "index.parquet",
    }
    bundle["findings.json"] = {row["name"]: row["findings"] for row in rows}
    bundle["index.parquet"] = index(rows)
    return bundle


def index(rows: list[dict[str, Any]]) -> pa.Table:
    """One row an episode: name, file, task, rows, commands, duration [s], rate [Hz], jitter [s], cameras, and each condition."""
    names = sorted({name for row in rows for name in row["conditions"]})
    columns: dict[str, pa.Array] = {
        "name": pa.array([row["name"] for row in rows], pa.string()),
        "file": pa.array([row["file"] for row in rows], pa.string()),
        "task": pa.array([row["task"] for row in rows], pa.string()),
        "rows": pa.array([row["rows"] for row in rows], pa.int64()),
        "commands": pa.array([row["commands"] for row in rows], pa.int64()),
    }
    columns |= {name: pa.array([row[name] for row in rows], pa.float64()) for name in ("duration", "rate", "jitter")}
    columns["cameras"] = pa.array([row["cameras"] for row in rows], pa.list_(pa.string()))
    columns |= {f"condition.{name}": pa.array([row["conditions"].get(name) for row in rows], pa.float64()) for name in names}
    return pa.table(columns)


ENTRY = Stage(name="ingest", version=1, needs=(), config=IngestConfig, run=run, sources=sources)
