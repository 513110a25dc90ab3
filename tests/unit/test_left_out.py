"""What errors on motions that a fit did not see are worth."""

from types import SimpleNamespace

import numpy as np
import pytest

from edream.diagnosis import left_out
from edream.diagnosis.left_out import (
    SEEN_ORDINARY,
    asks_for_more,
    does_better,
    gap_above_floor,
    is_material,
)


@pytest.mark.parametrize(
    ("rms", "errors", "asks"), [(0.9, [8.0] + 8 * [0.9], False), (0.9, 9 * [1.3], True), (1.5, [8.0] + 8 * [0.9], True)]
)
def test_where_the_fit_is_at_the_floor_motions_left_out_ask_for_an_effect_together(
    rms: float, errors: list[float], asks: bool
) -> None:
    """All in floors; one motion that a servo at its limit just fails in says nothing of what is missing."""
    problem = SimpleNamespace(floor=1.0, joints=("tilt",), settings=SimpleNamespace(seed=0))
    fit, squares = SimpleNamespace(rms=rms, residual=np.full(6, rms)), np.array(errors) ** 2
    assert asks_for_more(problem, fit, squares, squares, frozenset()) is asks


@pytest.mark.parametrize(
    ("without", "beside", "named"), [(12.0, 1.1, True), (12.0, 4.0, False), (2.5, 1.1, False), (30.0, 14.0, True)]
)
def test_beside_a_large_effect_a_small_one_is_named_where_it_closes_a_clear_gap(without: float, beside: float, named: bool) -> None:
    """Friction at a place left 12 floors beside a slew limit that had left 280, and was less than a twentieth of these."""
    problem = SimpleNamespace(floor=1.0, joints=("pan",), settings=SimpleNamespace(seed=0))
    first, before, after = (np.full(9, error**2) for error in (280.0, without, beside))
    fit = SimpleNamespace(rms=without, residual=np.full(6, without))
    assert is_material(problem, first, (before, fit), (after, fit), frozenset()) is named
    assert asks_for_more(problem, fit, first, before, frozenset()) is (without > 3.0)


@pytest.mark.parametrize(("errors", "gap"), [(0.8, 0.21), (1.1, 0.21), (4.0, 3.0)])
def test_a_gap_that_cannot_be_seen_counts_as_the_least_that_can(errors: float, gap: float) -> None:
    """So what is gained on one joint is a share that means something where the mean over many is at the floor; squared floors."""
    assert gap_above_floor(SimpleNamespace(floor=1.0), np.full(6, errors)) == pytest.approx(gap)


@pytest.mark.parametrize(
    ("other", "better"),
    [(9 * [1.4], True), (9 * [1.02], False), ([8.0] + 8 * [1.0], False), ([8.0] + 8 * [1.2], True), ([1.4], True), ([1.02], False)],
)
def test_a_fit_does_better_by_what_can_be_seen_and_not_in_one_motion_alone(
    monkeypatch: pytest.MonkeyPatch, other: list[float], better: bool
) -> None:
    """A gripper's servo had been called three times too weak for one motion of nine, and did worse on those never fitted."""
    errors = {"fit": np.ones(len(other)), "other": np.array(other) ** 2}  # in floors
    monkeypatch.setattr(left_out, "left_out_errors", lambda problem, fit: errors[fit])
    problem = SimpleNamespace(floor=1.0, settings=SimpleNamespace(seed=0))
    assert does_better(problem, "fit", "other") is better
    assert not does_better(problem, "other", "fit")


def test_an_effect_with_which_numbers_are_ordinary_needs_half_as_much(monkeypatch: pytest.MonkeyPatch) -> None:
    """A gear of 0.9 on SO-101's elbow had been called a rotor that is 1.42 times the published one, then nothing at all."""
    errors = {"fit": np.ones(9), "other": np.full(9, 1.04**2), "same": np.full(9, 1.02**2)}
    monkeypatch.setattr(left_out, "left_out_errors", lambda problem, fit: errors[fit])
    problem = SimpleNamespace(floor=1.0, settings=SimpleNamespace(seed=0))
    assert not does_better(problem, "fit", "other")
    assert does_better(problem, "fit", "other", SEEN_ORDINARY)
    assert not does_better(problem, "fit", "same", SEEN_ORDINARY)
