"""Commands on the store as a whole: status, verify, gc."""

import json as json_
from collections.abc import Sequence
from pathlib import Path

import typer
from omegaconf import DictConfig

from edream import catalog, cli_show, pipeline
from edream.core.errors import EdreamError, unknown_name
from edream.core.stage import stage_of


def status(cfg: DictConfig, overrides: Sequence[str], json: bool) -> None:
    """Print what exists and, where settings are given, what they would still make and why."""
    store = pipeline.open_store(cfg)
    artifacts = store.artifacts()
    runs = store.runs()
    found = {
        "runs": {
            name: {"command": run["command"], "made": [f"{stage_of(need)}/{key}" for need, key in run["made"].items()]}
            for name, run in runs.items()
        },
        "artifacts": [
            {
                "artifact": f"{one.stage}/{one.key}",
                "made": one.manifest["made"]["at"],
                "seconds": one.manifest["made"]["seconds"],
                "MB": round(sum(file["bytes"] for file in one.manifest["files"].values()) / 1e6, 2),
            }
            for one in artifacts
        ],
    }
    if any(not override.startswith("runs=") for override in overrides):
        found["plan"] = [
            {"stage": step.stage, "key": step.key, "state": step.state, "changed": list(step.changes)} for step in _plan(cfg)
        ]
    if json:
        print(json_.dumps(found, indent=2))
    elif any(found.values()):
        cli_show.table(found)
    else:
        print(f"Nothing has been made in {store.root} yet.")


def verify(cfg: DictConfig, json: bool) -> None:
    """Print every problem; exit with 2 where there is one."""
    store = pipeline.open_store(cfg)
    _exists(store.root)
    problems = store.verify()
    if json:
        print(json_.dumps({"ok": not problems, "problems": problems}, indent=2))
    else:
        print("\n".join(problems) if problems else f"Every file in {store.root} is what was written.")
    if problems:
        raise typer.Exit(2)


def gc(cfg: DictConfig, forget: Sequence[str], json: bool) -> None:
    """Forget runs, then remove what no run names."""
    store = pipeline.open_store(cfg)
    _exists(store.root)
    for name in forget:
        if name not in store.runs():
            raise unknown_name("run", name, store.runs())
    removed = store.gc(forget)
    if json:
        print(json_.dumps({"removed": [str(path) for path in removed]}, indent=2))
    else:
        print("\n".join(f"removed {path}" for path in removed) or "Nothing to remove: a run names every artifact.")


def _plan(cfg: DictConfig) -> list[pipeline.Step]:
    """The plan of every stage whose settings are complete."""
    steps: dict[str, pipeline.Step] = {}
    for name in catalog.names("stages"):
        try:
            steps |= {step.stage: step for step in pipeline.plan(name, cfg)}
        except EdreamError as error:
            steps[name] = pipeline.Step(name, None, f"cannot be made: {error}")
    return list(steps.values())


def _exists(root: Path) -> None:
    if not root.is_dir():
        raise EdreamError(f"There is no folder {root}. Expected the folder of artifacts; name it as runs=DIR.")
