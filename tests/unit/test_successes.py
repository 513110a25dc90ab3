"""Several evaluations in one table."""

from typing import Any

from edream.practice.naming import brief, label
from edream.practice.rates import rate
from edream.report.successes import Evaluated, beside, papers_share

PAPER = {"SFT, 3 views": 0.60, "SFT, 1 view": 0.49, "RL, 1 view": 0.77}


def row(policy: str, name: str, done: int, trials: int = 100) -> dict[str, Any]:
    one = rate([True] * done + [False] * (trials - done))
    return {"policy": policy, "name": name, "success": {"share": one.share, "interval": one.interval, "trials": one.trials}}


def evaluated(task: str, seed: int, sft: int, rl: int, alone: tuple[int, int] = (1, 2)) -> Evaluated:
    rates = [row("sft", "SFT, 1 view", sft), row("rl", "RL, 1 view", rl)]
    return Evaluated(task, seed, rates, {"first": alone[0], "second": alone[1]})


def found(table: dict[str, Any], begins: str) -> tuple[str, ...]:
    return next(cells for cells in table["rows"] if cells[0].startswith(begins))


def test_tasks_stand_below_one_another_with_their_mean_and_how_many_times_the_supervised_policy_s_it_is() -> None:
    table = beside([evaluated("cup", 1, 40, 60, (3, 23)), evaluated("pen", 1, 20, 24, (2, 6))], PAPER)
    assert table["heads"][1:] == ("SFT, 1 view", "RL, 1 view")
    assert found(table, "cup")[2].startswith("60.0 [50.2, ")
    assert found(table, "mean of 2 tasks")[1:] == ("30.0", "42.0") and found(table, "mean / mean of SFT")[1:] == ("1.00", "1.40")
    assert found(table, "paper")[1:] == ("49", "77")
    assert "RL, 1 view 42.0 %, 1.40 times as often." in table["sentence"]
    assert table["sentence"].endswith("5 starts were done by SFT, 1 view alone, 29 by RL, 1 view alone.")
    assert not [cells for cells in table["rows"] if cells[0].startswith("spread")], "tasks differ for other reasons than chance"


def test_seeds_of_one_task_have_a_mean_and_a_spread_and_no_paper_beside_them() -> None:
    table = beside([evaluated("cup", seed, 40 + 10 * seed, 80) for seed in (1, 2, 3)], PAPER)
    assert found(table, "mean of 3 seeds")[1:] == ("60.0", "80.0") and found(table, "spread")[1:] == ("10.0", "0.0")
    assert [cells[0] for cells in table["rows"]][:3] == ["seed 1", "seed 2", "seed 3"]
    assert not [cells for cells in table["rows"] if cells[0].startswith("paper")]


def test_a_policy_that_was_not_judged_everywhere_has_no_mean() -> None:
    views = "sft policy.cameras=[a,b,c] sft.twins=false"
    more = evaluated("pen", 1, 20, 30)
    more = Evaluated(more.task, more.seed, [row(views, "SFT, policy.cameras=[a,b,c], 3 views", 90), *more.rates], more.paired)
    table = beside([evaluated("cup", 1, 40, 60), more], PAPER)
    place = table["heads"].index("SFT, policy.cameras=[a,b,c], 3 views")
    assert found(table, "cup")[place] == "–" and found(table, "mean of")[place] == "–" and found(table, "mean /")[place] == "–"
    assert found(table, "paper")[place] == "60"
    assert "alone" not in table["sentence"], "they begin with other policies"


def test_nothing_is_divided_by_a_policy_that_never_succeeds() -> None:
    table = beside([evaluated("cup", 1, 0, 60), evaluated("pen", 1, 0, 30)], PAPER)
    assert not [cells for cells in table["rows"] if cells[0].startswith("mean /")] and "times" not in table["sentence"]


def test_the_paper_stands_beside_policies_of_its_kind_alone() -> None:
    theirs = {
        "sft": ("SFT, 1 view", 0.49),
        "sft policy.cameras=[a] sft.twins=false": ("SFT, policy.cameras=[a], sft.twins=false, 1 view", 0.49),
    }
    theirs |= {"rl policy.cameras=[a] rollouts.eyes=dreamed": ("RL, policy.cameras=[a], rollouts.eyes=dreamed, 1 view", 0.77)}
    theirs |= {"rl": ("RL, 3 views", None), "rl rollouts.model=published": ("RL, rollouts.model=published, 1 view", None)}
    theirs |= {"sft policy.cameras=[]": ("SFT, policy.cameras=[], no camera", None)}
    for policy, (name, share) in theirs.items():
        assert papers_share(policy, name, PAPER) == share, policy


def test_a_policy_that_went_on_from_a_folder_is_named_after_the_folder_alone() -> None:
    assert label("sft sft.start=/a/b/1b79 sft.change.share=0.5") == "SFT, sft.start=1b79, sft.change.share=0.5"
    assert label(f"sft sft.start=runs/sft/{'d4de8089dae' * 2}"[:-2]) == "SFT, sft.start=d4de80"
    assert brief("SFT, 1 view") == "SFT, 1 view"
    many = "SFT, sft.start=d4de80, sft.change.share=0.5, sft.train.steps=6000, 1 view"
    assert brief(many) == "SFT, sft.start=d4de80, sft.change.share=0.5, ..., 1 view"
    three = label("sft policy.cameras=[cam_high,cam_side,wrist] sft.twins=false") + ", 3 views"
    assert brief(three) == "SFT, sft.twins=false, 3 views", "the number of views says enough of the cameras"
    assert label("rl rl.rounds=2") == f"{label('rl')}, rl.rounds=2"
