"""Names that lead no further give way to what they were not told from, where that does."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from edream.diagnosis import another_way
from edream.diagnosis.decide import Round
from edream.diagnosis.trials import Trial
from tests.still_problem import left_by

PROBLEM = SimpleNamespace(floor=1.0, settings=SimpleNamespace(seed=0, threads=1))
FIT = SimpleNamespace(rms=5.0)


def a_round(left: float, trials: list[Trial], taken: Trial | None) -> Round:
    return Round(FIT, np.full(8, left), [], trials, taken)  # type: ignore[arg-type]


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The rivals from which the search goes on: friction at a place is found beside a slew limit, nothing beside the others."""
    asked: list[str] = []

    def forward(problem: object, fit: object, done: object, before: list[Round]) -> tuple[object, object, list[Round]]:
        last = before[-1].taken
        assert last is not None
        asked.append(last.candidate.effect)
        if last.candidate.effect != "slew_limit":
            return problem, fit, [*before, a_round(LEFT["beside the spring"], [], None)]
        more = left_by("position_friction", LEFT["beside the slew limit"], 1.0)
        return problem, "the end", [*before, a_round(30.0, [more], more), a_round(LEFT["beside the slew limit"], [], None)]

    monkeypatch.setattr(another_way, "forward", forward)
    monkeypatch.setattr(another_way, "arrived", lambda problem, before, taken: taken.fit)
    monkeypatch.setattr(another_way, "polish", lambda fit: fit)
    monkeypatch.setattr(another_way, "stands", lambda problem, candidate, fit: True)
    monkeypatch.setattr(
        another_way,
        "predicted",
        lambda problem, fit, taken: np.full(8, LEFT["beside the slew limit" if fit == "the end" else "beside the spring"]),
    )
    monkeypatch.setitem(LEFT, "beside the slew limit", 1.1)
    return asked


LEFT = {"beside the slew limit": 1.1, "beside the spring": 30.0}  # squared floors at the end of another way


def stuck(left: float, rival: float = 31.0) -> list[Round]:
    """A torque limit that a spring and a limit of the setpoint do as well as, and nothing more beside it."""
    first = [left_by("torque_limit", 30.0, 0.95), left_by("spring", 30.5, 0.949), left_by("slew_limit", rival, 0.948)]
    return [a_round(500.0, first, first[0]), a_round(left, [], None)]


def test_a_rival_beside_which_the_gap_closes_takes_the_place_of_a_name(asked: list[str]) -> None:
    rounds = stuck(30.0)
    _, end, found = another_way.by_another_way(PROBLEM, FIT, rounds)  # type: ignore[arg-type]
    assert asked == ["spring", "slew_limit"] and end == "the end"
    assert [one.taken.candidate.effect if one.taken else None for one in found] == ["slew_limit", "position_friction", None]
    assert found[0].trials == rounds[0].trials, "what it may be stays known"


@pytest.mark.parametrize(
    ("rounds", "left", "tried"),
    [
        (stuck(5.0), 1.1, []),  # no clear gap is left
        (stuck(30.0), 12.0, ["spring", "slew_limit"]),  # the other way leaves one, too
        (stuck(30.0, rival=400.0), 1.1, ["spring"]),  # motions tell the rival from the name
        ([a_round(30.0, [], None)], 1.1, []),  # nothing is named
    ],
)
def test_names_stay_where_no_other_way_leads_to_the_end(
    asked: list[str], rounds: list[Round], left: float, tried: list[str]
) -> None:
    LEFT["beside the slew limit"] = left
    assert another_way.by_another_way(PROBLEM, FIT, rounds) == (PROBLEM, FIT, rounds)  # type: ignore[arg-type]
    assert asked == tried


def test_a_rival_that_does_not_stand_at_its_end_leads_nowhere(asked: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(another_way, "stands", lambda problem, candidate, fit: candidate.effect != "slew_limit")
    rounds = stuck(30.0)
    assert another_way.by_another_way(PROBLEM, FIT, rounds)[2] == rounds  # type: ignore[arg-type]
    assert asked == ["spring"]


def test_a_rival_that_leaves_no_clear_gap_by_itself_takes_the_place_of_a_name(
    asked: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(LEFT, "beside the spring", 1.2)
    _, _, found = another_way.by_another_way(PROBLEM, FIT, stuck(30.0))  # type: ignore[arg-type]
    assert asked == ["spring"]
    assert [one.taken.candidate.effect if one.taken else None for one in found] == ["spring", None]


def test_names_that_lead_on_to_the_last_round_stay(asked: list[str]) -> None:
    rounds = stuck(30.0)
    taken = [replace(one, taken=one.trials[0] if one.trials else left_by("cogging", 1.0, 1.0)) for one in rounds]
    assert another_way.by_another_way(PROBLEM, FIT, taken)[2] == taken  # type: ignore[arg-type]
    assert asked == []
