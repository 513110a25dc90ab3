"""A candidate's search goes on from where all motions say, and to its end where half-way there none is sure."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from edream.diagnosis import decide, trials
from edream.diagnosis.candidates import Candidate
from edream.diagnosis.descent import Fit, begin
from edream.diagnosis.problem import Problem
from edream.diagnosis.trials import Trial, gone_on
from tests.still_problem import FitOf, having

DELAY = Candidate("actuator_delay", ("tilt",))


@pytest.mark.parametrize("lost", [True, False])
def test_usual_numbers_that_went_with_a_few_motions_are_those_of_all_again(
    problem: Problem, fit: Fit, monkeypatch: pytest.MonkeyPatch, lost: bool
) -> None:
    """The recordings do as the model does: numbers elsewhere than `fit` are wrong."""
    monkeypatch.setattr(trials, "descend", lambda begun, fresh, iterations, tolerance: begun)
    away = np.clip(fit.unit + 0.1, 0.0, 1.0)
    before = fit if lost else begin(fit.objective, away)
    few = replace(before, objective=replace(fit.objective, windows=fit.objective.windows[:1]))
    near = having(problem, few, DELAY, {"time": 0.002})
    near = begin(near.objective, np.append(away if lost else fit.unit, near.unit[len(fit.unit) :]))
    begun = gone_on(before, near)
    assert len(begun.residual) == len(fit.residual) > len(near.residual)
    np.testing.assert_allclose(begun.unit, np.append(fit.unit, near.unit[len(fit.unit) :]), atol=1e-12)


@pytest.mark.parametrize(
    ("near", "numbers", "sure", "apart"), [(0.9, 5, True, False), (0.9, 6, True, True), (1.1, 5, True, True), (0.9, 5, False, True)]
)
def test_a_rival_that_meets_the_motions_as_well_with_no_more_numbers_is_not_told_apart(
    problem: Problem, near: float, numbers: int, sure: bool, apart: bool
) -> None:
    def trial(effect: str, rms: float, count: int, squared: float) -> Trial:
        there = SimpleNamespace(rms=rms, unit=np.zeros(count))
        return Trial(Candidate(effect, ("tilt",)), 0.1, there, np.full(9, squared), 0.6, True)

    winner, rival = trial("sensor_delay", 1.0, 5, 1.0), replace(trial("actuator_delay", near, numbers, 2.0), sure=sure)
    assert decide.rivals(problem, [winner, rival], winner) == [(rival, apart)]


def test_what_gains_in_the_fit_goes_on_where_motions_left_out_are_sure_of_none(monkeypatch: pytest.MonkeyPatch) -> None:
    """A delay of a hidden arm stood at -0.18 of the gap, by what stale columns had left of it, and closed 0.8 of it at its end."""

    def trial(name: str, rms: float, closed: float) -> Trial:
        return Trial(Candidate(name, ("tilt",)), 0.0, FitOf(name, rms), np.zeros(4), closed, False)

    monkeypatch.setattr(decide, "is_brief", lambda fit: True)
    monkeypatch.setattr(decide, "leaves_no_gap", lambda problem, fit: True)
    monkeypatch.setattr(decide, "worth", lambda objective, residual: 1.0)
    monkeypatch.setattr(decide, "passes", lambda problem, one: one.sure)
    monkeypatch.setattr(decide, "descend", lambda begun, fresh, iterations: replace(begun, rms=0.5))
    monkeypatch.setattr(decide, "judged", lambda problem, end, errors, one: replace(one, fit=end, closed=0.8, sure=True))
    problem = SimpleNamespace(floor=0.1, shared=(), settings=SimpleNamespace(gain=0.1, threads=1))
    before, tried = FitOf("before", 2.0), [trial("spring", 1.99, 0.05), trial("delay", 1.7, -0.18)]
    found = decide.settled(problem, before, np.ones(4), tried)
    assert [(one.candidate.effect, one.closed, one.sure) for one in found] == [("delay", 0.8, True), ("spring", 0.05, False)]
    assert decide.settled(problem, before, np.ones(4), tried[:1]) == tried[:1], "nothing gains in the fit either"


def test_what_the_best_is_known_to_be_confused_with_begins_again_sooner_than_others(
    problem: Problem, fit: Fit, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Beside drag that was not found yet a delay of the measurements stood at 0.55 of the gap, the commands' at 0.65."""

    def trial(effect: str, closed: float) -> Trial:
        return Trial(Candidate(effect, ("tilt",)), 0.1, fit, np.full(4, 1.0 - closed), closed, True)

    best, tried = trial("actuator_delay", 0.65), [trial("sensor_delay", 0.55), trial("quadratic_drag", 0.55)]
    monkeypatch.setattr(decide, "passes", lambda problem, one: one.sure)
    monkeypatch.setattr(decide, "leaves_no_gap", lambda problem, fit: False)
    monkeypatch.setattr(decide, "without", lambda fit, candidate: fit)
    monkeypatch.setattr(decide, "beside", lambda problem, bare, candidate: fit)
    monkeypatch.setattr(decide, "judged", lambda problem, end, errors, one: replace(one, closed=0.66))
    found = decide.restarted(problem, np.ones(4), [best, *tried])
    assert [(one.candidate.effect, one.closed) for one in found] == [
        ("sensor_delay", 0.66),
        ("actuator_delay", 0.65),
        ("quadratic_drag", 0.55),
    ]
