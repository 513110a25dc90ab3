"""What is said of motions that were never fitted."""

from types import SimpleNamespace

import numpy as np
import pytest

from edream.diagnosis import never_fitted
from edream.diagnosis.never_fitted import about, agreement, is_contradicted, is_left, on_others, still_off

MOTIONS = [SimpleNamespace(episode=SimpleNamespace(name=name)) for name in ("swing", "nod", "turn")]


def problem_of(floor: float) -> SimpleNamespace:
    return SimpleNamespace(floor=floor, proof=MOTIONS, joints=("pan", "tilt"), settings=SimpleNamespace(seed=0))


def squares(*errors: float) -> np.ndarray:
    """Mean squared errors, (K, J), of both joints alike, by their root in each motion."""
    return np.repeat(np.array(errors)[:, None], 2, axis=1) ** 2


def test_agreement_is_said_only_where_little_more_than_noise_is_left() -> None:
    problem = problem_of(0.393e-3)
    whole = agreement(problem, squares(*3 * [0.40e-3]))
    assert whole.startswith("Your simulator agrees with these recordings down to their noise")
    said = agreement(problem, squares(*3 * [0.602e-3]))
    assert "0.6 mrad on motions never fitted" in said and "explain 0.39." in said and "down to their noise" not in said
    assert said.startswith("Your simulator nearly agrees")
    missed = agreement(problem, squares(*3 * [1.0e-3]))
    assert "agrees" not in missed and "misses others: 1 mrad on motions never fitted" in missed


@pytest.mark.parametrize(
    ("errors", "where"),
    [
        ([[0.3, 0.3], [3.6, 3.6], [0.4, 0.4]], ", nearly all of it in nod"),
        ([[0.3, 3.6], [0.3, 2.9], [0.4, 3.1]], ", nearly all of it on tilt"),
        ([[0.3, 0.3], [0.3, 0.3], [24.0, 0.5]], ", nearly all of it on pan in turn"),
        ([[2.0, 1.5], [1.5, 2.0], [2.0, 1.8]], ""),
        ([[0.3, 0.3], [0.3, 0.3], [0.6, 0.3]], ""),  # too little to point anywhere
    ],
)
def test_what_is_left_in_one_place_is_said_to_be_there(errors: list[list[float]], where: str) -> None:
    assert on_others(problem_of(0.3e-3), (1e-3 * np.array(errors)) ** 2).endswith(f"where noise and repetition explain 0.3{where}")


def test_what_names_leave_on_motions_never_fitted_is_said_where_it_is_a_gap() -> None:
    problem = problem_of(0.3e-3)
    assert still_off(problem, squares(*3 * [0.5e-3])) == ""
    said = still_off(problem, squares(2.0e-3, 9.0e-3, 9.0e-3))
    assert said == " Still left: 7.4 mrad on motions never fitted, where noise and repetition explain 0.3."


def fit_of(*errors: float) -> SimpleNamespace:
    """A fit by the root-mean-square error of each joint on the fitted motions."""
    return SimpleNamespace(residual=np.tile(np.array(errors), 6))


def contradicted(
    monkeypatch: pytest.MonkeyPatch, left: float, before: np.ndarray, after: np.ndarray, closes: SimpleNamespace
) -> bool:
    """Errors in floors; `before` and `after` of each joint in each motion never fitted."""
    monkeypatch.setattr(never_fitted, "proof_squares", lambda problem, fit: before**2)
    return is_contradicted(problem_of(1.0), np.full(9, left**2), fit_of(9.0, 9.0), closes, after**2)


@pytest.mark.parametrize(
    ("left", "before", "after", "refuted"),
    [(1.1, 10.0, 5.5, True), (3.0, 10.0, 5.5, False), (1.1, 20.0, 5.5, False), (1.1, 2.9, 2.8, False), (1.1, 10.0, 12.0, True)],
)
def test_motions_never_fitted_contradict_a_name_that_follows_only_what_was_fitted(
    monkeypatch: pytest.MonkeyPatch, left: float, before: float, after: float, refuted: bool
) -> None:
    """Root-mean-square errors in floors. A cable that catches was a hardening spring, which left 2.2 and, on these, 5.5."""
    errors = np.full((3, 2), before), np.full((3, 2), after)
    assert contradicted(monkeypatch, left, *errors, fit_of(1.1, 1.1)) is refuted


@pytest.mark.parametrize(("fitted", "refuted"), [(1.1, True), (4.0, False)])
def test_what_a_name_leaves_on_its_joint_in_the_fit_is_no_news_on_motions_never_fitted(
    monkeypatch: pytest.MonkeyPatch, fitted: float, refuted: bool
) -> None:
    """The mean over many joints, here 1.2 floors, says less than what is left on the one."""
    before, after = np.full((3, 2), 8.0), np.array([[5.0, 1.0]] * 3)
    assert contradicted(monkeypatch, 1.2, before, after, fit_of(fitted, 8.9)) is refuted


@pytest.mark.parametrize(("own", "refuted"), [(0, False), (1, True)])
def test_a_joint_that_a_name_is_not_about_says_nothing_of_it(monkeypatch: pytest.MonkeyPatch, own: int, refuted: bool) -> None:
    """A spring on one joint was right, and another joint's servo reached its limit in one motion never fitted alone."""
    before, after = np.array([[9.0, 1.0], [9.0, 1.0], [9.0, 5.0]]), np.array([[1.0, 1.1], [1.0, 1.0], [1.0, 120.0]])
    closes = fit_of(*np.where(np.arange(2) == own, 1.0, 8.9))
    assert contradicted(monkeypatch, 1.2, before, after, closes) is refuted


def test_names_are_about_the_joints_on_which_they_close_the_gap() -> None:
    problem = problem_of(1.0)
    assert about(problem, fit_of(9.0, 2.0), fit_of(1.0, 1.9)).tolist() == [True, False]
    assert about(problem, fit_of(9.0, 8.0), fit_of(1.0, 1.0)).tolist() == [True, True]
    assert about(problem, fit_of(2.0, 2.0), fit_of(2.1, 2.1)).tolist() == [True, True]  # nothing is closed: of all


@pytest.mark.parametrize(
    ("left", "proof", "real"),
    [(0.8, [8.0, 1.0, 0.7], False), (0.8, [0.9, 1.0, 0.7], False), (3.0, [2.0, 4.0, 3.0], True), (1.4, [1.9, 2.0, 2.0], True)],
)
def test_a_gap_that_rests_on_one_motion_is_none_that_something_is_missing_for(left: float, proof: list[float], real: bool) -> None:
    """Root-mean-square errors in floors: of nine motions each while it was left out, and of three that were never fitted."""
    assert is_left(problem_of(1.0), np.full(9, left) ** 2, np.array(proof) ** 2) is real
