"""Rank: which trials of a start went better, success first and then the distance to the target, and which pairs to learn from."""

from collections.abc import Mapping
from dataclasses import dataclass

from edream.core.stage import Artifact, Bundle, Stage, Work
from edream.practice.ranking import RankOptions, ranked


@dataclass(frozen=True)
class RankConfig:
    """What rank reads."""

    rank: RankOptions


def run(inputs: Mapping[str, Artifact], config: RankConfig, work: Work) -> Bundle:
    """Rank the trials of every start and choose pairs."""
    outcomes = inputs["rollouts"]["outcomes.parquet"]
    order, pairs = ranked(outcomes, config.rank)
    starts = len(set(outcomes["start"].to_pylist()))
    by = pairs["by"].to_pylist()
    summary = {
        "sentence": f"{len(pairs)} pairs from {len(set(pairs['start'].to_pylist()))} of {starts} starts: {by.count('success')} "
        f"differ in success, {by.count('distance')} in distance alone, by {config.rank.margin:g} m or more.",
        "pairs": len(pairs),
        "by_success": by.count("success"),
        "starts": starts,
    }
    return {"ranks.parquet": order, "pairs.parquet": pairs, "summary.json": summary}


ENTRY = Stage("rank", 2, ("rollouts",), RankConfig, run, None, ("numpy",))
