"""Ingest: recordings of any supported format -> one checked MCAP file an episode, an index, and what was noticed."""

import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from edream.core.episode import Episode
from edream.core.errors import EdreamError, require
from edream.core.format import Malformed, ReadOptions
from edream.core.stage import Artifact, Bundle, Source, Stage, Work
from edream.ingest.episode_file import write_episode
from edream.ingest.findings import Findings, summarise
from edream.ingest.index import IndexRow, file_name, index_row, index_table
from edream.ingest.mapping import MappingConfig
from edream.ingest.recordings import ingest_recordings
from edream.sim.robot import RobotModel, load_robot

EPISODE, MALFORMED, ABOUT = "episode.mcap", "malformed.json", "about.json"


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

    def __post_init__(self) -> None:
        require(self.fps is None or self.fps > 0.0, "ingest.fps", self.fps, "rows a second, above 0")
        require(self.colour in ("rgb", "bgr"), "ingest.colour", self.colour, "rgb or bgr")
        require(self.images in ("png", "jpeg"), "ingest.images", self.images, "png or jpeg")


@dataclass(frozen=True)
class IngestRobot:
    """Of the robot only its joints count here."""

    mjcf: Path
    joints: tuple[str, ...] = ()


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
    robot = load_robot(config.robot.mjcf, recorded=config.robot.joints)
    joints = json.dumps({"joints": robot.joints, "ranges": joint_ranges(robot)}, sort_keys=True).encode()
    return {"data": data, "robot.joints": joints} | {f"beside/{path.name}": path for path in beside}


def joint_ranges(robot: RobotModel) -> dict[str, tuple[float, float]]:
    """Limits of the robot's limited joints [rad or m]."""
    model = robot.model
    limited = [name for name in robot.joints if model.joint(name).limited[0]]
    return {name: (float(model.joint(name).range[0]), float(model.joint(name).range[1])) for name in limited}


def run(inputs: Mapping[str, Artifact], config: IngestConfig, work: Work) -> Bundle:
    """Read, map and check the recordings one by one; each is kept as soon as it is written."""
    robot = load_robot(config.robot.mjcf, recorded=config.robot.joints)
    options = config.ingest
    _check_units(robot, options.mapping)
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
        about = {"row": index_row(episode, path), "findings": findings.sentences()}
        return {EPISODE: path, ABOUT: about} | {f"{name}.png": data for name, data in findings.previews.items()}

    shards = work.shards("episodes", _noting(found, seen), one, parallel=False)
    return _bundle(shards, robot.joints, summarise(seen))


def _check_units(robot: RobotModel, mapping: MappingConfig) -> None:
    """Refuse an angle for a joint that slides, and a length for one that turns: a gripper beside joints in degrees."""
    for joint in robot.joints if mapping.by != "none" else ():
        unit, slides = mapping.units.get(joint, mapping.unit), robot.model.joint(joint).type[0] == mujoco.mjtJoint.mjJNT_SLIDE
        if unit in (("deg",) if slides else ("m", "mm")):
            said = "slides, and is given in" if slides else "turns, and is given in"
            raise EdreamError(
                f"Joint {joint!r} {said} {unit!r}; give ingest.mapping.units.{joint}={'m or mm' if slides else 'rad or deg'}, or "
                f"normalised with ingest.mapping.scale.{joint}."
            )


def _noting(found: Iterator[tuple[Episode, Findings] | Malformed], seen: list[Findings]) -> Iterator[Any]:
    for item in found:
        if not isinstance(item, Malformed):
            seen.append(replace(item[1], previews={}))
        yield item


def _bundle(shards: Iterable[Artifact], joints: tuple[str, ...], noticed: tuple[str, ...]) -> Bundle:
    """The folder `episodes/`, which is a data set of its own (files and index), what was noticed, and a preview of the cameras."""
    bundle: dict[str, Any] = {}
    rows: list[IndexRow] = []
    malformed, findings, taken = [], {}, set()
    for shard in shards:
        if MALFORMED in shard:
            malformed.append(shard[MALFORMED])
            continue
        about = shard[ABOUT]
        row = IndexRow(**(about["row"] | {"file": file_name(about["row"]["name"], taken)}))
        taken.add(row.file)
        bundle[f"episodes/{row.file}"] = shard.path(EPISODE)
        if not rows:
            bundle |= {f"preview/{name}": shard.path(name) for name in shard if name.endswith(".png")}
        rows.append(row)
        findings[row.name] = about["findings"]
    duration = sum(row.duration for row in rows)
    lost = f"; {len(malformed)} malformed, named below and left out" if malformed else ""
    bundle["episodes/index.parquet"] = index_table(rows)
    bundle["findings.json"] = findings
    bundle["summary.json"] = {
        "sentence": f"{len(rows)} episodes, {duration:.0f} s, {len(joints)} joints{lost}.",
        "episodes": len(rows),
        "duration_s": duration,
        "joints": joints,
        "noticed": noticed,
        "malformed": malformed,
        "index": "episodes/index.parquet",
    }
    return bundle


ENTRY = Stage(name="ingest", version=4, needs=(), config=IngestConfig, run=run, sources=sources)
