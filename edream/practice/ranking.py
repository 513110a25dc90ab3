"""Which of several trials of one start went better, and which pairs are worth learning from."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa

from edream.core.errors import require


@dataclass(frozen=True)
class RankOptions:
    """How trials are compared.

    Attributes:
        margin: least difference of terminal distance that counts [m]; a success and a failure make a pair whatever their distance.
        pairs: most pairs of one start, the widest apart first.
    """

    margin: float = 0.01
    pairs: int = 4

    def __post_init__(self) -> None:
        require(self.margin >= 0.0, "rank.margin", self.margin, "metres, 0 or more")
        require(self.pairs >= 1, "rank.pairs", self.pairs, "at least 1")


def ranked(outcomes: pa.Table, options: RankOptions) -> tuple[pa.Table, pa.Table]:
    """Rank the trials of each start: success first, then the terminal distance.

    Args:
        outcomes: columns trial, start, sample, success, distance.

    Returns:
        The trials with their rank (0 the best) and advantage (how far above the mean of their start, in spreads), and the pairs:
        start, chosen, rejected (numbers of trials), gap [m], by (success or distance).
    """
    rows = outcomes.to_pylist()
    order: list[dict[str, object]] = []
    pairs: list[dict[str, object]] = []
    for start in sorted({row["start"] for row in rows}):
        group = sorted(
            (row for row in rows if row["start"] == start), key=lambda row: (not row["success"], row["distance"], row["trial"])
        )
        gains = advantages(group, options.margin)
        order += [
            {"trial": row["trial"], "start": start, "rank": rank, "advantage": gains[rank], "good": bool(row["success"])}
            for rank, row in enumerate(group)
        ]
        pairs += pairs_of(group, options)
    kinds = [("trial", pa.int64()), ("start", pa.int64()), ("rank", pa.int64()), ("advantage", pa.float64()), ("good", pa.bool_())]
    of_pairs = [("start", pa.int64()), ("chosen", pa.int64()), ("rejected", pa.int64()), ("gap", pa.float64()), ("by", pa.string())]
    return pa.Table.from_pylist(order, pa.schema(kinds)), pa.Table.from_pylist(pairs, pa.schema(of_pairs))


def pairs_of(group: Sequence[Mapping[str, object]], options: RankOptions) -> list[dict[str, object]]:
    """Pairs of one start's trials, best first in `group`, that differ enough; the widest apart first."""
    found = []
    for i, better in enumerate(group):
        for worse in group[i + 1 :]:
            gap = float(worse["distance"]) - float(better["distance"])  # type: ignore[arg-type]
            apart = better["success"] != worse["success"]
            if apart or gap >= options.margin:
                row = {"start": better["start"], "chosen": better["trial"], "rejected": worse["trial"], "gap": gap}
                found.append(row | {"by": "success" if apart else "distance"})
    found.sort(key=lambda pair: (pair["by"] != "success", -pair["gap"], pair["chosen"], pair["rejected"]))
    return found[: options.pairs]


def advantages(group: Sequence[Mapping[str, object]], margin: float = 0.0) -> list[float]:
    """Reward of each trial, less the mean of its group, in standard deviations; 0 where all went alike.

    The reward is 1 for success, and less the distance [m] up to half a metre, so that it orders trials as the ranking does. A
    distance counts in whole margins, as it does for pairs: under a margin of 1 m success alone counts.
    """
    reward = np.array([float(bool(row["success"])) - _counted(float(row["distance"]), margin) for row in group])  # type: ignore[arg-type]
    spread = reward.std()
    return [0.0] * len(group) if spread < 1e-9 else ((reward - reward.mean()) / spread).tolist()


def _counted(distance: float, margin: float) -> float:
    near = min(distance, 0.5)
    return near if margin == 0.0 else margin * float(np.floor(near / margin))


def why_no_pairs(done: int, trials: int) -> str:
    """Why there is nothing to learn from trials of which no two of a start differ by the margin, and what to do about it.

    Args:
        done: how many of the trials succeeded.
        trials: how many were played.
    """
    if done == trials:
        return (
            f"All {trials} trials succeeded, so that there is nothing to learn from them; ask for fewer rounds with rl.rounds, or "
            "leave more to chance with rollouts.noise.action."
        )
    mend = (
        "the policy does not work in the simulator: calibrate or diagnose it first, train with sft.twins=true or longer, or look "
        "at rollouts.eyes"
        if not done
        else "raise rollouts.noise.action or rollouts.samples, or lower rank.margin"
    )
    return f"{done} of {trials} trials succeeded, and none went better than another of its start by rank.margin; {mend}."


def taught_nothing(history: Sequence[Mapping[str, Any]]) -> str:
    """The rounds of a policy that had nothing to learn from, in a sentence with the first one's reason; empty where all had.

    Args:
        history: a row a round, with `round`, `trials`, `trial_success` (a share) and `pairs`.
    """
    idle = [row for row in history if not row["pairs"]]
    if not idle:
        return ""
    rounds = ", ".join(str(row["round"]) for row in idle)
    why = why_no_pairs(round(idle[0]["trial_success"] * idle[0]["trials"]), idle[0]["trials"])
    return f"Nothing was learned in round{'s' if len(idle) > 1 else ''} {rounds}: {why[0].lower()}{why[1:]}"
