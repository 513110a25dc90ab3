"""Two effects at once: the best candidate of a round that named none goes on where another one shows beside it."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from edream.diagnosis import by_two
from edream.diagnosis.decide import Round
from edream.diagnosis.remainder import Remainder
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
    """A base that leans shows beside a dead zone; how much both leave, and from what the search went on."""
    there = SimpleNamespace(beside=left_by("gravity_tilt", 9.0), ends=1.1, begun=[])

    def forward(problem: object, fit: object, done: object, before: list[Round]) -> tuple[object, object, list[Round]]:
        there.begun += [one.taken.candidate.effect for one in before if one.taken is not None]
        assert all(one.formula is None for one in before)
        both = Round(FIT, np.full(8, 64.0), [], [there.beside], there.beside)  # type: ignore[arg-type]
        return problem, "the end", [*before, both, Round(FIT, np.full(8, there.ends), [], [], None)]  # type: ignore[arg-type]

    monkeypatch.setattr(by_two, "forward", forward)
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
