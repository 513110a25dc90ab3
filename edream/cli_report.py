"""The command that shows the newest report, and writes it anew where it is missing; or one page about several runs."""

import json as json_
import webbrowser
from collections.abc import Callable
from pathlib import Path

from omegaconf import DictConfig, OmegaConf

from edream import cli_show, pipeline
from edream.core.errors import EdreamError
from edream.core.stage import stage_of
from edream.store import Store, StoredArtifact

REPORTED = {"fit": "fit", "diagnose": "diagnose", "score": "dream", "evaluate": "evaluate"}  # stage -> what its page is about


def report(cfg: DictConfig, open_it: bool, write: Callable[[str], object] | None) -> None:
    """The report of the newest calibration, diagnosis, dreamed video or policy in the store.

    Args:
        cfg: the composed config; of it only the store's place counts.
        open_it: show the page in a browser.
        write: prints the JSON object, or None to print for a person.

    Raises:
        EdreamError: nothing to report on was made yet.
    """
    store = pipeline.open_store(cfg)
    newest = _newest(store)
    if newest is None:
        first = "edream calibrate, diagnose, dream or train-policy"
        raise EdreamError(f"There is nothing to report on in {store.root}; run {first} first.")
    made = _written(store, newest) or _anew(store, newest, cfg)
    path = made.path(next(name for name in made if name.endswith(".html"))).absolute()
    found = {"report": str(path), "of": REPORTED[newest.stage], "artifact": str(newest.folder.absolute())}
    if write is not None:
        write(json_.dumps(found, indent=2))
    else:
        cli_show.table(found)
    if open_it:
        webbrowser.open(path.as_uri())


def whole(cfg: DictConfig, prefix: str, truth: Path | None, open_it: bool, write: Callable[[str], object] | None) -> None:
    """One page about every run whose name begins with `prefix` and a dash: our tables beside the paper's.

    Args:
        cfg: the composed config; of it only the store's place counts.
        prefix: what the names of the runs begin with; the page's own run has this name alone.
        truth: the sealed truth of a make-believe robot, to say what was hidden; None where there is none.
        open_it: show the page in a browser.
        write: prints the JSON object, or None to print for a person.

    Raises:
        EdreamError: there is no such run, or an artifact of it is gone.
    """
    from edream.record import revealed

    store = pipeline.open_store(cfg)
    runs = {name: run["made"] for name, run in store.runs().items() if name.startswith(f"{prefix}-")}
    if not runs:
        raise EdreamError(f"No run in {store.root} has a name that begins with {prefix}-; give your commands run={prefix}-NAME.")
    given = {}
    for run, made in runs.items():
        for need, key in made.items():
            artifact = store.find(stage_of(need), key)
            if artifact is None:
                raise EdreamError(f"The run {run} names {need} {key}, which does not exist; run its command again.")
            if artifact.stage != "report":
                given[f"{need} run={run}"] = artifact
    names = [one.manifest["fields"]["config"].get("robot", {}).get("name") for one in given.values()]
    about = {"of": "whole", "parts": list(given), "hidden": revealed(truth) if truth else []}
    OmegaConf.update(cfg, "report", OmegaConf.create(about))
    OmegaConf.update(cfg, "robot.name", next((name for name in names if name), None))
    with store.session():
        page = pipeline.make("report", cfg, given)
        store.name_run(prefix, {"command": f"report --whole {prefix}", "made": {"report": page.key}})
    path = page.path("report.html").absolute()
    if write is not None:
        write(json_.dumps({"report": str(path), "digest": page.digest, "runs": list(runs)}, indent=2))
    else:
        cli_show.table({"report": str(path), "digest": page.digest, "runs": list(runs)})
    if open_it:
        webbrowser.open(path.as_uri())


def _newest(store: Store) -> StoredArtifact | None:
    """The newest artifact that a page can be about; of fits that were made to compare with, or for a dream, not those."""
    named = {(run["command"], stage, key) for run in store.runs().values() for stage, key in run["made"].items()}
    about = {"fit": "calibrate", "diagnose": "diagnose", "score": "dream", "evaluate": "train-policy"}
    found = [one for one in store.artifacts() if one.stage in REPORTED]
    asked_for = [one for one in found if (about[one.stage], one.stage, one.key) in named]
    return (asked_for or found or [None])[-1]


def _written(store: Store, newest: StoredArtifact) -> StoredArtifact | None:
    """The report that there is."""
    pages = [one for one in store.artifacts() if one.stage == "report" and one.manifest["parents"].get(newest.stage) == newest.key]
    about = [one for one in pages if one.manifest["fields"]["config"]["report"]["of"] == REPORTED[newest.stage]]
    return about[-1] if about else None


def _anew(store: Store, newest: StoredArtifact, cfg: DictConfig) -> StoredArtifact:
    """The report, from what the store has."""
    given = pipeline.chain(store, newest)
    made_with = {name: one.manifest["fields"]["config"] for name, one in given.items()}
    OmegaConf.update(cfg, "report.of", REPORTED[newest.stage])
    robots = [settings["robot"]["name"] for settings in made_with.values() if (settings.get("robot") or {}).get("name")]
    OmegaConf.update(cfg, "robot.name", robots[0] if robots else None)
    if "fit" in made_with:
        OmegaConf.update(cfg, "fit.method", made_with["fit"]["fit"]["method"])
    if "render" in made_with:
        OmegaConf.update(cfg, "render.model", made_with["render"]["render"]["model"])
    return pipeline.make("report", cfg, given)
