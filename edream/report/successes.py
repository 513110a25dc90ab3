"""Several evaluations in one table, as papers have it: a row a task or seed, a column a policy, and what they mean together."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import mean, stdev
from typing import Any

Row = tuple[str, ...]
SEEN = {"policy.cameras", "sft.twins", "rollouts.eyes"}  # settings by which policies of the paper's own table differ


@dataclass(frozen=True)
class Evaluated:
    """One evaluation.

    Attributes:
        task: what was to be done.
        seed: of the whole chain.
        rates: a row a policy, as the stage evaluate made them: name, policy, success.
        paired: starts that only the first and only the last of the policies did; None where there was one policy.
    """

    task: str
    seed: int
    rates: Sequence[Mapping[str, Any]]
    paired: Mapping[str, Any] | None


def beside(several: Sequence[Evaluated], paper: Mapping[str, float]) -> dict[str, Any]:
    """What stands in the table: its heads, its rows, one sentence.

    A mean is taken only over policies that every evaluation judged: a mean over easier tasks would tell nothing.

    Args:
        several: two evaluations at least.
        paper: share of successes in the paper, by kind of policy and what it sees; a mean of four tasks.
    """
    names: dict[str, str] = {}
    for one in several:
        names |= {row["policy"]: row["name"] for row in one.rates if row["policy"] not in names}
    shares = {
        policy: [row["success"]["share"] for one in several for row in one.rates if row["policy"] == policy] for policy in names
    }
    whole = {policy: found for policy, found in shares.items() if len(found) == len(several)}
    tasks = list(dict.fromkeys(one.task for one in several))
    kind = "seeds" if len({one.seed for one in several}) == len(several) else "evaluations"
    what = f"{len(tasks)} tasks" if len(tasks) > 1 else f"{len(several)} {kind}"
    rows = [(_name(one, tasks), *(_cell(one, policy) for policy in names)) for one in several]
    rows.append((f"mean of {what}", *(_percent(mean(whole[policy])) if policy in whole else "–" for policy in names)))
    if len(tasks) == 1:
        rows.append(("spread (standard deviation)", *(_percent(stdev(whole[p])) if p in whole else "–" for p in names)))
    if "sft" in whole and mean(whole["sft"]) > 0.0:
        rows.append((f"mean / mean of {names['sft']}", *(_ratio(whole.get(p), whole["sft"]) for p in names)))
    if len(tasks) > 1:
        rows.append(("paper's mean of four tasks", *(_theirs(policy, name, paper) for policy, name in names.items())))
    told = ", ".join(f"{names[policy]} {_percent(mean(found))} %" for policy, found in whole.items())
    return {
        "heads": ("success [%], Wilson's 95 % interval", *names.values()),
        "rows": rows,
        "sentence": f"Mean of {what}: {told or 'no policy was judged in all of them'}{_times(whole)}.{_alone(several)}",
    }


def _name(one: Evaluated, tasks: Sequence[str]) -> str:
    return f"{one.task}, seed {one.seed}" if len(tasks) > 1 else f"seed {one.seed}"


def _cell(one: Evaluated, policy: str) -> str:
    for row in one.rates:
        if row["policy"] == policy:
            low, high = row["success"]["interval"]
            return f"{_percent(row['success']['share'])} [{_percent(low)}, {_percent(high)}]"
    return "–"


def _times(whole: Mapping[str, Sequence[float]]) -> str:
    """How many times as often the last policy succeeds as the supervised one."""
    last = list(whole)[-1] if whole else "sft"
    if last == "sft" or mean(whole.get("sft", [0.0])) == 0.0:
        return ""
    return f", {_ratio(whole[last], whole['sft'])} times as often"


def _alone(several: Sequence[Evaluated]) -> str:
    """Starts that only the first or only the last policy did, where these are the same policies everywhere."""
    ends = {(one.rates[0]["policy"], one.rates[-1]["policy"]) for one in several}
    if len(ends) != 1 or any(one.paired is None for one in several):
        return ""
    first, last = (sum(int(one.paired[side]) for one in several if one.paired) for side in ("first", "second"))
    rates = several[0].rates
    return f" {first} starts were done by {rates[0]['name']} alone, {last} by {rates[-1]['name']} alone."


def papers_share(policy: str, name: str, paper: Mapping[str, float]) -> float | None:
    """What the paper reports of such a policy; None of one that it has not.

    Args:
        policy: with the settings that it alone has, as `evaluate.of` names it.
        name: ends with what it sees, such as "1 view".
        paper: shares by kind and view.
    """
    if not {setting.partition("=")[0] for setting in policy.split(" ")[1:]} <= SEEN:
        return None
    return paper.get(f"{name.partition(', ')[0]}, {name.rpartition(', ')[2]}")


def _theirs(policy: str, name: str, paper: Mapping[str, float]) -> str:
    found = papers_share(policy, name, paper)
    return "–" if found is None else f"{100 * found:.0f}"


def _ratio(share: Sequence[float] | None, base: Sequence[float]) -> str:
    return "–" if share is None else f"{mean(share) / mean(base):.2f}"


def _percent(share: float) -> str:
    return f"{100 * share:.1f}"
