"""What a user should know before trusting a fit: sentences, none where all is well."""

from collections.abc import Mapping
from typing import Any

from edream.calibration.worth import Estimate, Worth


def reservations(worth: Worth, error: Mapping[str, Any], motions: int) -> list[str]:
    """What data leave open, what stands at the end of its range, and whether motions never fitted are followed worse than before.

    Args:
        worth: the numbers found, with their intervals.
        error: errors on `train` and, where motions were held out, `heldout`, each with those `before`; `joint_rmse_rad` in rad.
        motions: how many the numbers were fitted to.
    """
    said = [direction.sentence for direction in worth.directions]
    ends = [f"{name} ({one.value:.3g} {one.unit})" for name, one in worth.estimates.items() if _at_an_end(one)]
    if ends:
        said.append(
            f"{', '.join(ends)} {'stands' if len(ends) == 1 else 'stand'} at the end of what was searched, as numbers do that make "
            "up for something the model lacks: `edream diagnose` looks for it; fit.limits widens the search."
        )
    if "heldout" in error:
        before, after = (one["joint_rmse_rad"] for one in (error["heldout"]["before"], error["heldout"]))
        if after > before:
            said.append(
                f"Motions it never saw are followed worse than before ({before:.4g} to {after:.4g} rad): "
                f"{numbered(len(worth.estimates), 'number')} from {numbered(motions, 'motion')} may be too many. Record more, let "
                "joints share their numbers (robot.ties), or name fewer effects (robot.effects)."
            )
    return said


def _at_an_end(one: Estimate) -> bool:
    """Whether a number stands at the end of its range; one of nothing, such as no dry friction, may well be true."""
    return one.status == "at_bound" and not (one.low == 0.0 and one.value < 0.5 * one.high)


def numbered(count: int, noun: str) -> str:
    """A number of things in words: 1 motion, 3 motions."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"
