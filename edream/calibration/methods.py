"""Ways to fit side by side, on the same loss and recordings."""

from collections.abc import Mapping
from typing import Any

from edream.core.stage import Artifact, stage_of


def methods(made: Mapping[str, Artifact]) -> list[dict[str, Any]]:
    """What each way to fit cost and reached.

    Args:
        made: need -> artifact: fits, such as `fit` and `fit fit.method=cmaes`, and what was swept and learned for each.

    Returns:
        A row for each fit, that of `fit` first: `method`; `heldout_rad` and `train_rad`, root-mean-square replay errors of whole
        motions; `seconds` of the clock, those of its sweep and its surrogate too; `simulations`; `converged`. Empty where there is
        one fit alone, since that is no comparison.
    """
    fits = [need for need in made if stage_of(need) == "fit"]
    return [_row(made, need.removeprefix("fit")) for need in sorted(fits, key=lambda need: need != "fit")] if len(fits) > 1 else []


def _row(made: Mapping[str, Artifact], settings: str) -> dict[str, Any]:
    summary = made["fit" + settings]["summary.json"]
    parts = [made[stage + settings] for stage in ("sweep", "surrogate", "fit") if stage + settings in made]
    errors = {f"{side}_rad": summary["error"][side]["joint_rmse_rad"] for side in ("heldout", "train") if side in summary["error"]}
    cost = {"seconds": round(sum(part.seconds for part in parts), 1), "simulations": summary["simulations"]}
    return {"method": summary["method"], **errors, **cost, "converged": summary["converged"]}
