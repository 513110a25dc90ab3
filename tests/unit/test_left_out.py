"""What errors on motions that a fit did not see are worth."""

from types import SimpleNamespace

import numpy as np
import pytest

from edream.diagnosis import left_out
from edream.diagnosis.left_out import (
    SEEN_ORDINARY,
    agreement,
    asks_for_more,
    does_better,
    gap_above_floor,
    is_left,
    is_material,
    is_refuted,
    still_off,
)


def test_agreement_is_said_only_where_little_more_than_noise_is_left() -> None:
    motions = [SimpleNamespace(episode=SimpleNamespace(name=name)) for name in ("swing", "nod", "turn")]
    problem = SimpleNamespace(floor=0.393e-3, proof=motions)
    assert agreement(problem, np.full(3, 0.40e-3**2)).startswith("Your simulator agrees with these recordings down to their noise")
    said = agreement(problem, np.full(3, 0.602e-3**2))
    assert "0.6 mrad on motions never fitted" in said and "explain 0.39." in said and "down to their noise" not in said
    assert said.startswith("Your simulator nearly agrees")
    missed = agreement(problem, np.full(3, 1.0e-3**2))
    assert "agrees" not in missed and "misses others: 1 mrad on motions never fitted" in missed
    assert "2.1 mrad on motions never fitted, where noise and repetition explain 0.39, all of it in nod." in agreement(
        problem, np.array([0.3e-3, 3.6e-3, 0.4e-3]) ** 2
    )


def test_what_names_leave_on_motions_never_fitted_is_said_where_it_is_a_gap() -> None:
    problem = SimpleNamespace(floor=0.3e-3)
    assert still_off(problem, np.full(3, 0.5e-3**2)) == ""
    said = still_off(problem, np.array([2.0e-3, 9.0e-3, 9.0e-3]) ** 2)
    assert said == " Still left: 7.4 mrad on motions never fitted, where noise and repetition explain 0.3."


@pytest.mark.parametrize(
    ("left", "before", "after", "refuted"),
    [(1.1, 10.0, 5.5, True), (3.0, 10.0, 5.5, False), (1.1, 20.0, 5.5, False), (1.1, 2.9, 2.8, False), (1.1, 10.0, 12.0, True)],
)
def test_motions_never_fitted_contradict_a_name_that_follows_only_what_was_fitted(
    left: float, before: float, after: float, refuted: bool
) -> None:
    """Root-mean-square errors in floors. A cable that catches was a hardening spring, which left 2.2 and, on these, 5.5."""
    squares = (np.full(count, error) ** 2 for count, error in ((9, left), (3, before), (3, after)))
    assert is_refuted(SimpleNamespace(floor=1.0), *squares) is refuted


@pytest.mark.parametrize(
    ("left", "proof", "real"),
    [(0.8, [8.0, 1.0, 0.7], False), (0.8, [0.9, 1.0, 0.7], False), (3.0, [2.0, 4.0, 3.0], True), (1.4, [1.9, 2.0, 2.0], True)],
)
def test_a_gap_that_rests_on_one_motion_is_none_that_something_is_missing_for(left: float, proof: list[float], real: bool) -> None:
    """Root-mean-square errors in floors: of nine motions each while it was left out, and of three that were never fitted."""
    problem = SimpleNamespace(floor=1.0, settings=SimpleNamespace(seed=0))
    assert is_left(problem, np.full(9, left) ** 2, np.array(proof) ** 2) is real


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
