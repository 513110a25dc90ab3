"""Doubts of first rounds, asked again beside the names that came later."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from edream.diagnosis import doubts
from edream.diagnosis.candidates import Candidate, placement
from edream.diagnosis.decide import Round
from edream.diagnosis.descent import Fit, begin
from edream.diagnosis.nuisance import published
from edream.diagnosis.problem import Settings, prepare
from edream.diagnosis.screen import extend
from edream.diagnosis.trials import Trial
from edream.sim.rollout import rollout
from edream.sim.simulation import SimulatedRobot
from tests.still_problem import NOISE, left_by, still_problem

PROBLEM = SimpleNamespace(floor=1.0, settings=SimpleNamespace(seed=0, threads=1))


@pytest.fixture
def rounds() -> list[Round]:
    """A tilt that a spring does nearly as well as, then a dead zone."""
    first = [left_by("gravity_tilt", 12.0, 0.55), left_by("spring", 12.4, 0.53), left_by("cogging", 26.0, 0.02)]
    last = [left_by("dead_zone", 1.0, 1.0)]
    fit = SimpleNamespace(rms=5.0)
    return [Round(fit, np.full(8, 27.0), [], first, first[0]), Round(fit, first[0].errors, [], last, last[0])]  # type: ignore[arg-type]


@pytest.mark.parametrize(("beside", "doubts_left"), [(9.0, []), (1.0, ["spring"])])
def test_a_rival_stays_one_only_where_it_does_as_well_beside_the_other_names(
    monkeypatch: pytest.MonkeyPatch, rounds: list[Round], beside: float, doubts_left: list[str]
) -> None:
    names = [one.taken for one in rounds if one.taken]
    named = [one.candidate for one in names]
    assert [one.candidate.effect for one in doubts.doubtful(PROBLEM, rounds[0], names[0], named)] == ["spring"]
    ends = {"gravity_tilt": (1.0, 0.95), "spring": (beside, 0.95 - 0.1 * (beside - 1.0))}
    tried: list[str] = []

    def in_place(problem: object, fit: object, name: Candidate, rival: Trial, behind: float) -> SimpleNamespace:
        assert name.effect == "gravity_tilt"
        tried.append(rival.candidate.effect)
        return SimpleNamespace(rms=ends[rival.candidate.effect][0] ** 0.5, unit=np.zeros(3))

    def judged(problem: object, fit: SimpleNamespace, errors: np.ndarray, one: Trial) -> Trial:
        left, closed = ends[one.candidate.effect]
        return replace(one, fit=fit, errors=np.full(8, left), closed=closed)  # type: ignore[arg-type]

    monkeypatch.setattr(doubts, "in_place", in_place)
    monkeypatch.setattr(doubts, "judged", judged)
    monkeypatch.setattr(doubts, "refitted_without", lambda problem, fit, name: fit)
    monkeypatch.setattr(doubts, "left_out_errors", lambda problem, fit: np.full(8, 20.0))
    fit = SimpleNamespace(rms=1.0, unit=np.zeros(3))
    again, after = doubts.asked_again(PROBLEM, fit, rounds, names, names[-1].errors)  # type: ignore[arg-type]
    assert tried == ["spring"] and [one.candidate for one in again] == named
    assert [one.candidate.effect for one in doubts.doubtful(PROBLEM, after[0], again[0], named)] == doubts_left
    assert after[1] is rounds[1] and again[1] is names[1], "the last name's rivals stood beside all others"


@pytest.mark.parametrize(("left", "beside", "doubts_left"), [(2.0, 9.0, []), (2.0, 2.0, ["spring"]), (9.0, 9.0, ["spring"])])
def test_rivals_of_the_last_name_are_asked_again_where_its_search_has_gone_far_since(
    monkeypatch: pytest.MonkeyPatch, rounds: list[Round], left: float, beside: float, doubts_left: list[str]
) -> None:
    """A name that left 12 half-way and leaves 2 at its end stood beside a rival half-way, too; one that leaves 9 did not."""
    only, name = rounds[0], rounds[0].taken
    assert name is not None
    fit, ends = SimpleNamespace(rms=1.0), {"gravity_tilt": left, "spring": beside}
    monkeypatch.setattr(doubts, "in_place", lambda problem, fit, name, rival, behind: fit)
    monkeypatch.setattr(
        doubts,
        "judged",
        lambda problem, fit, errors, one: replace(
            one, errors=np.full(8, ends[one.candidate.effect]), closed=(27.0 - ends[one.candidate.effect]) / 26.0
        ),
    )
    monkeypatch.setattr(doubts, "refitted_without", lambda problem, fit, name: fit)
    monkeypatch.setattr(doubts, "left_out_errors", lambda problem, fit: np.full(8, 27.0))
    again, after = doubts.asked_again(PROBLEM, fit, [only], [name], np.full(8, left))  # type: ignore[arg-type]
    assert (after[0] is only) == (left == 9.0)
    assert [one.candidate.effect for one in doubts.doubtful(PROBLEM, after[0], again[0], [name.candidate])] == doubts_left


def test_a_rival_in_the_place_of_a_name_begins_beside_the_other_names_and_ends_where_it_can() -> None:
    """A constant torque, put in the place of a lag, makes up for none of it, beside a spring that stays."""
    bare = still_problem()
    windows = (*bare.fitted, *bare.proof)
    hidden = [placement(bare, Candidate("actuator_lag", ("tilt",))), placement(bare, Candidate("spring", ("tilt",)))]
    true = SimulatedRobot(bare.robot, tuple(hidden))
    there = {"actuator_lag": 0.03, "spring.stiffness": 2.0}
    values = [next((v for key, v in there.items() if p.name.startswith(key)), p.start) for p in true.space.parameters]
    moved = rollout(true, np.array([values]), windows)
    rng = np.random.default_rng(4)
    noisy = [replace(w.episode, position=m[0] + rng.normal(0.0, NOISE, m[0].shape)) for w, m in zip(windows, moved, strict=True)]
    problem = prepare(bare.robot, noisy, Settings())
    usual = Fit(published(problem), np.zeros(0), np.zeros(0), np.zeros((0, 0)), 1.0)
    both, _ = extend(usual, hidden)
    fit = begin(both, both.simulated.space.to_unit(np.array(values)))
    torque, lag = Candidate("constant_torque", ("tilt",)), Candidate("actuator_lag", ("tilt",))
    alone, absent = extend(usual, [placement(problem, torque)])
    rival = Trial(torque, 0.1, begin(alone, alone.simulated.space.to_unit(absent)), np.ones(4), 0.5, True)
    end = doubts.in_place(problem, fit, lag, rival)
    assert {p.effect.name for p in end.objective.simulated.placements} >= {"spring", "constant_torque"}
    assert "actuator_lag" not in {p.effect.name for p in end.objective.simulated.placements}
    assert end.rms > doubts.BEHIND * fit.rms and not end.ended
    again = doubts.in_place(problem, fit, lag, Trial(lag, 0.1, fit, np.ones(4), 0.5, True))
    assert again.ended and again.rms < 1.01 * fit.rms
