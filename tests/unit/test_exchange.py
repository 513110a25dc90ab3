"""Names that give way to what they are confused with, once others stand beside them."""

from types import SimpleNamespace

import numpy as np
import pytest

from edream.diagnosis import exchange
from edream.diagnosis.candidates import Candidate
from edream.diagnosis.decide import Round
from edream.diagnosis.trials import Trial

PROBLEM = SimpleNamespace(floor=1.0, settings=SimpleNamespace(seed=0, threads=1))
MOTIONS = 6


def trial(effect: str, left: float, rms: float = 1.0) -> Trial:
    return Trial(Candidate(effect, ("pan",)), 0.1, SimpleNamespace(rms=rms), np.full(MOTIONS, left), 0.8, True)


def rounds(*effects: str) -> list[Round]:
    taken = [trial(effect, 4.0) for effect in effects]
    last = Round(taken[-1].fit, np.full(MOTIONS, 4.0), [], [], None)
    return [*(Round(one.fit, one.errors, [], [one], one) for one in taken), last]


@pytest.fixture
def stand_ins(monkeypatch: pytest.MonkeyPatch) -> None:
    """Beside the other names a lag leaves 1.2 floors squared where the delay leaves four; nothing does better than the spring."""
    monkeypatch.setattr(exchange, "refitted_without", lambda problem, fit, candidate: fit)
    monkeypatch.setattr(exchange, "left_out_errors", lambda problem, fit: np.full(MOTIONS, 40.0))
    monkeypatch.setattr(exchange, "judged", lambda problem, fit, errors, one: one)
    monkeypatch.setattr(exchange, "polish", lambda fit: fit)
    monkeypatch.setattr(exchange, "passes", lambda problem, one: one.sure)
    others = {"actuator_delay": [trial("actuator_lag", 1.2)], "spring": [trial("hardening_spring", 3.9)]}
    monkeypatch.setattr(exchange, "instead", lambda problem, fit, name: [(t.fit, t) for t in others.get(name.effect, [])])


@pytest.mark.usefixtures("stand_ins")
def test_a_delay_gives_way_to_a_lag_that_closes_half_of_what_is_left_beside_a_spring() -> None:
    fit, found, told = exchange.exchanged(PROBLEM, SimpleNamespace(rms=2.0), rounds("actuator_delay", "spring"))
    assert [one.taken and one.taken.candidate.effect for one in found] == ["actuator_lag", "spring", None]
    assert [t.candidate.effect for t in found[0].trials] == ["actuator_lag", "actuator_delay"]
    assert [label for label, _ in told] == ["actuator_lag[pan] instead"]
    assert fit.rms == 1.0


@pytest.mark.usefixtures("stand_ins")
@pytest.mark.parametrize(("rms", "names"), [(1.2, ["actuator_delay", "spring"]), (2.0, ["actuator_delay"])])
def test_names_stay_where_they_leave_little_or_one_is_alone(rms: float, names: list[str]) -> None:
    fit, found, told = exchange.exchanged(PROBLEM, SimpleNamespace(rms=rms), rounds(*names))
    assert [one.taken.candidate.effect for one in found[:-1] if one.taken] == names
    assert (fit.rms, told) == (rms, [])


@pytest.mark.parametrize(("left", "better"), [(2.6, False), (2.4, True)])
def test_what_is_exchanged_closes_half_of_what_is_above_the_floor(left: float, better: bool) -> None:
    assert exchange.is_better(PROBLEM, trial("actuator_lag", left), trial("actuator_delay", 4.0)) is better


def test_a_gain_on_one_motion_alone_is_none() -> None:
    new = trial("actuator_lag", 4.0)
    new.errors[0] = 0.0
    new.errors[1:] += 0.2
    assert not exchange.is_better(SimpleNamespace(floor=1.9, settings=PROBLEM.settings), new, trial("actuator_delay", 4.0))
