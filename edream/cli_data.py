"""Commands that write data sets: record, export."""

import json as json_
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from omegaconf import DictConfig

from edream import cli_show, config, pipeline

Write = Callable[[str], object] | None
SECONDS = 10.0  # a policy's loop runs so long where no task says it


def record_robot(cfg: DictConfig, write: Write) -> None:
    """Record the make-believe robot that the config names."""
    from edream.calibration.settings import RobotSettings
    from edream.record import RecordConfig, record
    from edream.record_task import record_task

    robot = config.read(cfg.robot, RobotSettings, "robot").load()
    settings = config.read(cfg.record, RecordConfig, "record")
    if cfg.task is None:
        _print(record(robot, settings, int(cfg.seed)), write)
    else:
        _print(record_task(robot, str(cfg.task), settings, int(cfg.seed), int(cfg.executor.workers)), write)


def export_episodes(cfg: DictConfig, to: str, out: Path, write: Write) -> None:
    """Ingest where that is not done, then write the episodes in another format."""
    from edream.export import export

    made, run = pipeline.make_run("export", ("ingest",), cfg)
    _print(export(made["ingest"], to, out) | {"run": str(run.absolute())}, write)


def export_policy(cfg: DictConfig, of: str, out: Path, write: Write) -> None:
    """Train a policy where that is not done, then write it as a folder of its own."""
    from edream import catalog
    from edream.core.errors import EdreamError, unknown_name
    from edream.core.task import Task
    from edream.practice.bundle import write_bundle

    if of not in ("sft", "rl"):
        raise unknown_name("policy", of, ("sft", "rl"))
    if out.exists():
        raise EdreamError(f"There is already something at {out}; --out must name a new folder.")
    seconds = SECONDS if cfg.task is None else catalog.load("tasks", str(cfg.task), Task).seconds
    made, run = pipeline.make_run("export-policy", (of,), cfg)
    _print(write_bundle(made[of], out, seconds) | {"run": str(run.absolute())}, write)


def _print(summary: Mapping[str, Any], write: Write) -> None:
    if write is not None:
        write(json_.dumps(summary, indent=2))
    else:
        cli_show.table(summary)
