"""An earlier name gives way to a rival that does better beside the name that came last."""

from types import SimpleNamespace

import numpy as np
import pytest

from edream.diagnosis import doubts, instead
from edream.diagnosis.candidates import Candidate
from edream.diagnosis.decide import Round
from edream.diagnosis.trials import Trial
from tests.still_problem import left_by

PROBLEM = SimpleNamespace(floor=1.0, settings=SimpleNamespace(seed=0, threads=1))
STUCK = SimpleNamespace(rms=4.0)
# squared floors that models leave: each effect alone, beside friction, and beside a slew limit
ALONE = {"torque_limit": 170.0, "slew_limit": 172.0, "compliance": 400.0}
BESIDE = {"torque_limit": 20.0, "slew_limit": 1.1, "compliance": 1.0, "position_friction": 1.1, "load_friction": 1.2}


def two_rounds() -> list[Round]:
    """A torque limit that a slew limit does as well as, then friction, which friction with the load does all but as well as."""
    first = [left_by(effect, left) for effect, left in ALONE.items()]
    second = [left_by("position_friction", 20.0), left_by("load_friction", 20.5), left_by("cogging", 120.0)]
    return [
        Round(STUCK, np.full(8, 2500.0), [], first, first[0]),  # type: ignore[arg-type]
        Round(first[0].fit, np.full(8, 170.0), [], second, second[0]),
    ]


@pytest.fixture(autouse=True)
def world(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, str]]:
    """Which rival was put in the place of which name; without a name a fit leaves 2000 floors, squared."""
    asked: list[tuple[str, str]] = []

    def in_place(problem: object, fit: object, name: Candidate, rival: Trial, behind: float) -> SimpleNamespace:
        assert behind == (1.0 if name.effect == "torque_limit" else doubts.BEHIND), "to be better it has to come nearer"
        asked.append((name.effect, rival.candidate.effect))
        return SimpleNamespace(rms=BESIDE[rival.candidate.effect] ** 0.5, unit=np.zeros(3))

    def judged(problem: object, fit: SimpleNamespace, errors: np.ndarray, one: Trial) -> Trial:
        left = float(fit.rms**2)
        closed = (float(errors.mean()) - left) / (float(errors.mean()) - 1.0)
        return Trial(one.candidate, one.share, fit, np.full(8, left), closed, True)  # type: ignore[arg-type]

    monkeypatch.setattr(doubts, "in_place", in_place)
    monkeypatch.setattr(doubts, "judged", judged)
    monkeypatch.setattr(
        doubts, "refitted_without", lambda problem, fit, name: SimpleNamespace(rms=45.0, without=(fit, name.effect))
    )
    monkeypatch.setattr(doubts, "left_out_errors", lambda problem, fit: np.full(8, 2000.0))
    monkeypatch.setattr(instead, "passes", lambda problem, one: one.sure)
    return asked


def test_a_rival_takes_the_place_of_an_earlier_name_beside_which_the_gap_closes(world: list[tuple[str, str]]) -> None:
    fit, found = instead.doubted_instead(PROBLEM, STUCK, two_rounds())  # type: ignore[arg-type]
    assert world == [("torque_limit", "slew_limit"), ("position_friction", "load_friction")], "what motions told apart is not asked"
    assert [one.taken and one.taken.candidate.effect for one in found] == ["slew_limit", "position_friction"]
    assert fit.rms**2 == pytest.approx(1.1)
    assert found[0].taken in found[0].trials and found[1].taken in found[1].trials
    assert found[1].before.without == (fit, "position_friction"), "its gap is what is left without it, beside the rival"
    np.testing.assert_array_equal(found[1].errors, np.full(8, 2000.0))
    assert [t.candidate.effect for t in found[1].trials] == ["position_friction", "load_friction"]
    assert found[1].taken is not None and found[1].taken.fit is fit


def test_every_later_name_is_held_against_what_is_left_without_it_and_those_after_it(world: list[tuple[str, str]]) -> None:
    third = left_by("cogging", 18.0)
    rounds = [*two_rounds(), Round(STUCK, np.full(8, 20.0), [], [third], third)]  # type: ignore[arg-type]
    fit, found = instead.doubted_instead(PROBLEM, STUCK, rounds)  # type: ignore[arg-type]
    assert [one.taken and one.taken.candidate.effect for one in found] == ["slew_limit", "position_friction", "cogging"]
    assert found[2].before.without == (fit, "cogging") and found[2].taken is not None and found[2].taken.fit is fit
    assert found[1].before.without == (found[2].before, "position_friction")
    assert found[1].taken is not None and found[1].taken.fit is found[2].before
    assert world == [("torque_limit", "slew_limit"), ("position_friction", "load_friction")]


@pytest.mark.parametrize(("beside_friction", "rms"), [(12.0, 4.0), (1.1, 1.2)])
def test_names_stay_where_no_rival_closes_half_of_what_is_left_or_little_is(
    monkeypatch: pytest.MonkeyPatch, world: list[tuple[str, str]], beside_friction: float, rms: float
) -> None:
    monkeypatch.setitem(BESIDE, "slew_limit", beside_friction)
    rounds, fit = two_rounds(), SimpleNamespace(rms=rms)
    assert instead.doubted_instead(PROBLEM, fit, rounds) == (fit, rounds)  # type: ignore[arg-type]
    assert world == ([("torque_limit", "slew_limit")] if rms > 2.0 else [])


def test_a_name_alone_stays(world: list[tuple[str, str]]) -> None:
    rounds = two_rounds()[:1]
    assert instead.doubted_instead(PROBLEM, STUCK, rounds) == (STUCK, rounds)  # type: ignore[arg-type]
    assert world == []
