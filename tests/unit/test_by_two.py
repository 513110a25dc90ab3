"""Two effects at once: the best candidate of a round that named none goes on where another one shows beside it."""

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from edream.diagnosis import by_two
from edream.diagnosis.decide import Round
from edream.diagnosis.remainder import Remainder
from edream.diagnosis.shooting import Pair
from edream.diagnosis.trials import Trial
from tests.still_problem import left_by

PROBLEM = SimpleNamespace(floor=1.0, settings=SimpleNamespace(seed=0, threads=1))
FIT = SimpleNamespace(rms=10.0)
FORMULA = 60.0  # squared floors that it leaves


def unnamed(trials: list[Trial], formula: float | None = FORMULA) -> list[Round]:
    """A first round that left a gap of 100 squared floors and took none of its trials."""
    found = None if formula is None else Remainder("pan", "tau", None, FIT, np.full(8, formula), True)  # type: ignore[arg-type]
    return [Round(FIT, np.full(8, 100.0), [], trials, None, found)]  # type: ignore[arg-type]


@pytest.fixture
def leaning(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """A base that leans shows beside a dead zone; how much both leave, what is found at once, and from what the search went on."""
    there = SimpleNamespace(beside=left_by("gravity_tilt", 9.0), ends=1.1, begun=[], pair=None, far=True)

    def forward(
        problem: object, fit: object, done: object, before: list[Round], known: Sequence[Trial] = ()
    ) -> tuple[object, object, list[Round]]:
        there.begun += [one.taken.candidate.effect for one in before if one.taken is not None]
        there.begun += [one.candidate.effect for one in known]
        assert all(one.formula is None for one in before)
        both = Round(FIT, np.full(8, 64.0), [], [there.beside], there.beside)  # type: ignore[arg-type]
        return problem, "the end", [*before, both, Round(FIT, np.full(8, there.ends), [], [], None)]  # type: ignore[arg-type]

    monkeypatch.setattr(by_two, "forward", forward)
    monkeypatch.setattr(by_two, "far_off", lambda problem, fit: there.far)
    monkeypatch.setattr(by_two, "both_at_once", lambda problem, fit, errors: there.pair)
    monkeypatch.setattr(by_two, "arrived", lambda problem, before, best: best.fit)
    monkeypatch.setattr(by_two, "polish", lambda fit: fit)
    monkeypatch.setattr(by_two, "stands", lambda problem, candidate, fit: candidate.effect != "lag")
    monkeypatch.setattr(by_two, "left_out_errors", lambda problem, fit: np.full(8, 64.0))
    monkeypatch.setattr(by_two, "screen_twice", lambda problem, fit, done: [])
    monkeypatch.setattr(by_two, "try_best", lambda problem, fit, errors, scored, done: [there.beside])
    monkeypatch.setattr(by_two, "predicted", lambda problem, fit, taken: np.full(8, there.ends))
    return there


@pytest.mark.parametrize("formula", [FORMULA, None])
def test_the_best_candidate_goes_on_where_another_shows_beside_it(leaning: SimpleNamespace, formula: float | None) -> None:
    trials = [left_by("dead_zone", 64.0, 0.36), left_by("backlash", 80.0, 0.2)]
    _, end, found = by_two.by_two(PROBLEM, FIT, unnamed(trials, formula))  # type: ignore[arg-type]
    assert leaning.begun == ["dead_zone"] and end == "the end"
    assert [one.taken.candidate.effect if one.taken else None for one in found] == ["dead_zone", "gravity_tilt", None]
    assert found[0].trials == trials, "what it may be stays known"


@pytest.mark.parametrize(
    ("trials", "formula", "beside", "ends", "begun"),
    [
        ([], FORMULA, 9.0, 1.1, []),  # no candidate gains
        ([replace(left_by("dead_zone", 64.0, 0.36), sure=False)], FORMULA, 9.0, 1.1, []),
        ([left_by("lag", 64.0, 0.36)], FORMULA, 9.0, 1.1, []),  # at its end it may be absent
        ([left_by("dead_zone", 64.0, 0.36)], 8.0, 2.0, 1.1, []),  # a formula leaves no clear gap
        ([left_by("dead_zone", 64.0, 0.36)], FORMULA, 50.0, 1.1, []),  # both leave nearly as much as the formula
        ([left_by("dead_zone", 64.0, 0.36)], None, 60.0, 1.1, []),  # or, without one, as the best candidate
        ([left_by("dead_zone", 64.0, 0.36)], FORMULA, 9.0, 9.5, ["dead_zone"]),  # in the end a clear gap is left
    ],
)
def test_otherwise_nothing_is_named(
    leaning: SimpleNamespace, trials: list[Trial], formula: float | None, beside: float, ends: float, begun: list[str]
) -> None:
    leaning.beside, leaning.ends = left_by("gravity_tilt", beside), ends
    rounds = unnamed(trials, formula)
    assert by_two.by_two(PROBLEM, FIT, rounds) == (PROBLEM, FIT, rounds)  # type: ignore[arg-type]
    assert leaning.begun == begun


def test_names_that_were_found_stay(leaning: SimpleNamespace) -> None:
    taken = left_by("dead_zone", 64.0, 0.36)
    rounds = [Round(FIT, np.full(8, 100.0), [], [taken], taken), Round(FIT, np.full(8, 64.0), [], [], None)]  # type: ignore[arg-type]
    assert by_two.by_two(PROBLEM, FIT, rounds) == (PROBLEM, FIT, rounds)  # type: ignore[arg-type]
    assert not leaning.begun


def weak_motor_and_spring(left: float) -> Pair:
    """A spring, and a torque limit beside it that leaves so much [squared floors]."""
    return Pair(PROBLEM, left_by("spring", 90.0, 0.1), left_by("torque_limit", left))  # type: ignore[arg-type]


def test_two_that_are_found_at_once_go_on_before_the_best_candidate(leaning: SimpleNamespace) -> None:
    leaning.pair = weak_motor_and_spring(2.0)
    _, end, found = by_two.by_two(PROBLEM, FIT, unnamed([left_by("dead_zone", 64.0, 0.36)]))  # type: ignore[arg-type]
    assert end == "the end" and found[0].taken == leaning.pair.first
    assert leaning.begun == ["spring", "torque_limit"]


@pytest.mark.parametrize(("far", "left", "ends"), [(False, 2.0, 1.1), (True, 50.0, 1.1), (True, 2.0, 9.5)])
def test_otherwise_they_are_not_the_answer(leaning: SimpleNamespace, far: bool, left: float, ends: float) -> None:
    """Not far off; both leave nearly as much as a formula; a clear gap is left in the end, more than hardly any of the first."""
    leaning.pair, leaning.far, leaning.ends = weak_motor_and_spring(left), far, ends
    rounds = unnamed([])
    assert by_two.by_two(PROBLEM, FIT, rounds) == (PROBLEM, FIT, rounds)  # type: ignore[arg-type]
    assert leaning.begun == (["spring", "torque_limit"] if far and left < 50.0 else [])


def test_two_found_at_once_may_leave_hardly_any_of_a_large_gap(leaning: SimpleNamespace) -> None:
    leaning.pair, leaning.ends = weak_motor_and_spring(12.0), 12.0
    first = replace(unnamed([])[0], errors=np.full(8, 20000.0))
    _, _, found = by_two.by_two(PROBLEM, FIT, [first])  # type: ignore[arg-type]
    assert found[0].taken == leaning.pair.first
