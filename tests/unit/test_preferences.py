"""Learning from trials that went better or worse: signs, anchors, ranking, rates."""

import math
import re
from dataclasses import replace

import numpy as np
import pyarrow as pa
import pytest
import torch

from edream import catalog
from edream.learn.policy import log_likelihood
from edream.learn.preference import Judged, Preference, PreferenceOptions
from edream.practice.ranking import RankOptions, ranked, taught_nothing
from edream.practice.rates import apart, paired, rate

B = 0.1
EXECUTED = torch.tensor([[[0.2], [0.4]], [[-0.3], [-0.1]]])  # the chosen trajectory, then the rejected one
VALID = torch.ones(2, 2, dtype=torch.bool)


def judged(mean: torch.Tensor, good: tuple[bool, bool] = (True, False)) -> Judged:
    mu = mean.expand(2, 2, 1)  # the reference's mean is 0
    reference = log_likelihood(EXECUTED, torch.zeros(2, 2, 1), VALID, B, "laplace")
    ratio = log_likelihood(EXECUTED, mu, VALID, B, "laplace") - reference
    error = (EXECUTED - mu).abs().flatten(1).sum(1) / B
    rows = [torch.tensor([0]), torch.tensor([1])]
    moved, towards = (mu**2).flatten(1).sum(1) / B**2, (mu * EXECUTED).flatten(1).sum(1) / B**2
    told = [torch.tensor([1.0, -1.0]), torch.tensor(good), EXECUTED.abs().flatten(1).sum(1) / B, moved, towards]
    return Judged(ratio, error, torch.full((2,), 2.0), *rows, *told)


@pytest.mark.parametrize("name", catalog.names("preferences"))
def test_every_objective_moves_the_policy_towards_what_went_well(name: str) -> None:
    mean = torch.zeros(1, 2, 1, requires_grad=True)
    loss = catalog.load("preferences", name, Preference).loss(judged(mean), PreferenceOptions(beta=0.1))
    loss.backward()
    assert mean.grad is not None and (mean.grad < 0).all(), "descending must raise the mean, for the chosen actions lie above it"


def test_tpo_is_what_hand_computes_and_without_alpha_it_is_the_paper_s() -> None:
    mean = torch.full((1, 2, 1), 0.1)
    one = judged(mean)
    gap = 0.1 * ((0.2 / B) - (-0.2 / B))  # each of two actions is 0.1 nearer to the chosen, 0.1 farther from the rejected
    paper = -math.log(1.0 / (1.0 + math.exp(-gap)))
    anchor = 0.1 * (0.1 + 0.3) / B
    tpo, plain = (catalog.load("preferences", name, Preference) for name in ("tpo", "tpo_paper"))
    assert float(plain.loss(one, PreferenceOptions(beta=0.1, alpha=1.0))) == pytest.approx(paper, rel=1e-5)
    assert float(tpo.loss(one, PreferenceOptions(beta=0.1, alpha=0.0))) == pytest.approx(paper, rel=1e-5)
    assert float(tpo.loss(one, PreferenceOptions(beta=0.1, alpha=1.0))) == pytest.approx(paper + anchor, rel=1e-5)


def test_grpo_stops_where_the_ratio_has_left_its_region_and_cloning_wants_successes_only() -> None:
    mean = torch.full((1, 2, 1), 0.2, requires_grad=True)  # ratio per number e^2: far outside
    one = judged(mean)
    better = replace(one, advantage=torch.tensor([1.0, 0.0]))
    catalog.load("preferences", "grpo", Preference).loss(better, PreferenceOptions(clip=0.2)).backward()
    assert mean.grad is not None and (mean.grad == 0).all()
    nothing = judged(torch.zeros(1, 2, 1), good=(False, False))
    assert float(catalog.load("preferences", "filtered_bc", Preference).loss(nothing, PreferenceOptions())) == 0.0


def test_the_natural_step_ends_where_each_trial_says_and_no_farther() -> None:
    entry = catalog.load("preferences", "natural", Preference)
    mean = torch.zeros(2, 2, 1, requires_grad=True)  # a mean of its own for each trial
    for _ in range(400):
        loss = entry.loss(judged(mean), PreferenceOptions(step=0.5))
        (gradient,) = torch.autograd.grad(loss, mean)
        mean = (mean - 0.01 * gradient).detach().requires_grad_()
    wanted = 0.5 * torch.tensor([1.0, -1.0])[:, None, None] * EXECUTED
    assert torch.allclose(mean, wanted, atol=1e-4), "half way to what went well, and half as far away from what did not"


def outcomes(*rows: tuple[int, bool, float]) -> pa.Table:
    return pa.Table.from_pylist(
        [{"trial": i, "start": s, "sample": i, "success": good, "distance": d} for i, (s, good, d) in enumerate(rows)]
    )


def test_success_ranks_before_distance_and_pairs_share_a_start_and_differ_by_the_margin() -> None:
    table = outcomes((1, False, 0.02), (1, True, 0.09), (1, False, 0.021), (1, False, 0.2), (2, False, 0.3), (2, False, 0.305))
    order, pairs = ranked(table, RankOptions(margin=0.01, pairs=10))
    assert [row["trial"] for row in order.to_pylist() if row["start"] == 1] == [1, 0, 2, 3]
    found = {(row["chosen"], row["rejected"], row["by"]) for row in pairs.to_pylist()}
    assert found == {(1, 0, "success"), (1, 2, "success"), (1, 3, "success"), (0, 3, "distance"), (2, 3, "distance")}
    gains = [row["advantage"] for row in order.to_pylist() if row["start"] == 1]
    assert gains == sorted(gains, reverse=True) and np.mean(gains) == pytest.approx(0.0, abs=1e-9)


def test_a_distance_below_the_margin_counts_no_more_for_the_advantage_than_for_pairs() -> None:
    table = outcomes((1, False, 0.02), (1, False, 0.4), (1, True, 0.1), (2, False, 0.1), (2, False, 0.4))
    order = {row["trial"]: row["advantage"] for row in ranked(table, RankOptions(margin=1.0))[0].to_pylist()}
    assert order[0] == order[1] < 0.0 < order[2] and order[3] == order[4] == 0.0
    order = {row["trial"]: row["advantage"] for row in ranked(table, RankOptions(margin=0.01))[0].to_pylist()}
    assert order[1] < order[0] < order[2] and order[4] < order[3]


def test_the_widest_pairs_are_kept() -> None:
    table = outcomes((1, False, 0.1), (1, False, 0.2), (1, False, 0.4))
    pairs = ranked(table, RankOptions(0.01, 1))[1]
    assert [(row["chosen"], row["rejected"]) for row in pairs.to_pylist()] == [(0, 2)]
    assert not len(ranked(outcomes((1, False, 0.1), (1, False, 0.1)), RankOptions())[1])


@pytest.mark.parametrize(
    "done, said",
    [(0, r"0 of 2 trials.*calibrate.*sft\.twins"), (1, r"1 of 2 trials.*rollouts\.samples"), (2, r"All 2.*rl\.rounds")],
)
def test_rounds_without_pairs_are_told_with_the_reason_of_the_first(done: int, said: str) -> None:
    idle = {"round": 2, "trials": 2, "trial_success": done / 2, "pairs": 0}
    assert taught_nothing([idle | {"round": 1, "pairs": 3}]) == ""
    told = taught_nothing([idle | {"round": 1, "pairs": 3}, idle, idle | {"round": 3, "trial_success": 1.0}])
    assert told.startswith("Nothing was learned in rounds 2, 3: ") and re.search(said, told, re.IGNORECASE)


def test_wilson_s_interval_is_the_one_in_the_books() -> None:
    found = rate([True] * 15 + [False] * 5)
    assert found.share == 0.75 and found.interval == pytest.approx((0.5313, 0.8881), abs=1e-4)
    assert rate([False] * 10).interval[0] == pytest.approx(0.0, abs=1e-12) and rate([False] * 10).interval[1] > 0.25
    assert apart(rate([True] * 90 + [False] * 10), rate([True] * 10 + [False] * 90)) and not apart(found, found)


def test_policies_are_compared_start_by_start_with_mcnemar_s_exact_test() -> None:
    found = paired([True] * 6 + [False] * 27 + [True] * 100, [False] * 6 + [True] * 27 + [True] * 100)
    by_hand = 2 * sum(math.comb(33, k) for k in range(7)) / 2**33
    assert (found.first, found.second) == (6, 27) and found.chance == pytest.approx(by_hand)
    assert paired([True, False], [True, False]).chance == 1.0
