"""The command that writes the newest report anew and shows it."""

import json as json_
import webbrowser
from collections.abc import Callable

from omegaconf import DictConfig, OmegaConf

from edream import cli_show, pipeline
from edream.core.errors import EdreamError

REPORTED = ("fit", "diagnose")


def report(cfg: DictConfig, open_it: bool, write: Callable[[str], object] | None) -> None:
    """Make the report of the newest fit or diagnosis in the store, from what the store has.

    Args:
        cfg: the composed config; of it only the store's place counts.
        open_it: show the page in a browser.
        write: prints the JSON object, or None to print for a person.

    Raises:
        EdreamError: nothing was fitted or diagnosed yet.
    """
    store = pipeline.open_store(cfg)
    newest = max(
        (one for one in store.artifacts() if one.stage in REPORTED), key=lambda one: one.manifest["made"]["at"], default=None
    )
    if newest is None:
        raise EdreamError(f"There is nothing to report on in {store.root}; run edream calibrate or edream diagnose first.")
    made_with = newest.manifest["fields"]["config"]
    OmegaConf.update(cfg, "report.of", newest.stage)
    OmegaConf.update(cfg, "robot.name", made_with["robot"]["name"])
    if newest.stage == "fit":
        OmegaConf.update(cfg, "fit.method", made_with["fit"]["method"])
    made = pipeline.make("report", cfg, pipeline.chain(store, newest))
    path = made.path(next(name for name in made if name.endswith(".html"))).absolute()
    found = {"report": str(path), "of": newest.stage, "artifact": str(newest.folder.absolute())}
    if write is not None:
        write(json_.dumps(found, indent=2))
    else:
        cli_show.table(found)
    if open_it:
        webbrowser.open(path.as_uri())
