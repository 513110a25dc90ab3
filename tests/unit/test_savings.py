"""What a diagnosis does not simulate, because it could not change the answer."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from edream.diagnosis import backward, decide, left_out, next_motion, screen, trials
from edream.diagnosis.candidates import Candidate
from edream.diagnosis.descent import Fit, begin, descend
from edream.diagnosis.few import thinned
from edream.diagnosis.next_motion import GLANCED, SECONDS, suggest
from edream.diagnosis.problem import Problem
from edream.diagnosis.screen import Scored, confirm, with_scan
from edream.diagnosis.set_up import other_set_ups
from edream.diagnosis.trials import Trial
from edream.sim.objective import Objective
from tests.still_problem import having


@pytest.fixture
def simulated(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Parameter sets that objectives simulate, one entry a call."""
    asked, run = list[int](), Objective.residuals

    def counted(self: Objective, values: np.ndarray) -> np.ndarray:
        asked.append(len(np.atleast_2d(values)))
        return run(self, values)

    monkeypatch.setattr(Objective, "residuals", counted)
    return asked


def test_a_step_that_does_not_even_promise_a_gain_is_not_simulated(problem: Problem, fit: Fit, simulated: list[int]) -> None:
    at_rest = replace(fit, jacobian=1e-9 * fit.jacobian)
    assert descend(at_rest) is at_rest
    assert simulated == []
    off = replace(fit, unit=np.clip(fit.unit + 0.02, 0.0, 1.0))
    off = replace(off, residual=off.objective.residuals(off.values)[0])
    del simulated[:]
    assert descend(off).rms < off.rms
    assert simulated


@pytest.mark.parametrize(("effect", "start", "sizes"), [("spring", {"stiffness": 0.2}, 3), ("torque_limit", {"torque": 2.0}, 9)])
def test_a_hopeless_candidate_is_looked_at_in_one_size(
    problem: Problem, fit: Fit, simulated: list[int], effect: str, start: dict[str, float], sizes: int
) -> None:
    parameters = screen.placement(problem, Candidate(effect, ("tilt",))).effect.parameters(problem.robot.model, ("tilt",))
    quantities = {p.name: start.get(p.name, p.start) for p in parameters}

    def looked_at(share: float, most: float) -> int:
        one = Scored(Candidate(effect, ("tilt",)), quantities, share)
        confirm(problem, fit, one, most, lambda residuals: (residuals**2).sum(axis=1), 1e9)
        count = sum(simulated)
        del simulated[:]
        return count

    assert looked_at(0.01, 0.5) == sizes  # simulated, it explains all but everything
    assert looked_at(0.01, 1e3) == 1
    assert looked_at(0.2e3, 1e3) == sizes


@pytest.mark.parametrize(
    ("share", "explained", "scanned"), [(0.1, 0.3, True), (0.1, 0.6, False), (0.63, 0.51, True), (0.5, 0.6, True)]
)
def test_lengths_of_waves_are_gone_through_where_nothing_else_explains_most(
    monkeypatch: pytest.MonkeyPatch, problem: Problem, fit: Fit, share: float, explained: float, scanned: bool
) -> None:
    """A ripple of another length than the first looks have had explained more than a gear did, and was not gone through."""
    found = Scored(Candidate("cogging", ("tilt",)), {"torque": 1.0}, 0.4)
    monkeypatch.setattr(screen, "scanned", lambda *told: found)
    wave, other = (Scored(Candidate(name, ("tilt",)), {}, share) for name, share in (("cogging", share), ("spring", explained)))
    assert with_scan(problem, fit, [wave, other]) == [found if scanned else wave, other]


def test_recordings_that_end_a_little_early_count_as_whole(fit: Fit) -> None:
    longest = max(float(window.times[-1]) for window in fit.objective.windows)
    assert len(thinned(fit, 1.02 * longest).objective.windows) == 1
    assert len(thinned(fit, 1.2 * longest).objective.windows) == 2


def test_first_looks_at_a_small_robot_take_some_of_its_motions(fit: Fit, problem: Problem, monkeypatch: pytest.MonkeyPatch) -> None:
    assert trials.on_few(problem, fit) is fit, "these are short"
    longest = max(float(window.times[-1]) for window in fit.objective.windows)
    monkeypatch.setattr(trials, "ENOUGH", 0.51 * longest)
    few = trials.on_few(problem, fit)
    assert len(few.objective.windows) == 1 and few.objective.simulated is fit.objective.simulated


def test_what_is_left_without_a_name_is_refitted_once(
    monkeypatch: pytest.MonkeyPatch, problem: Problem, fit: Fit, simulated: list[int]
) -> None:
    name = Candidate("spring", ("tilt",))
    extended, absent = screen.extend(fit, [screen.placement(problem, name)])
    with_it = begin(extended, np.clip(extended.simulated.space.to_unit(absent), 0.0, 1.0))
    del simulated[:]
    first = backward.refitted_without(problem, with_it, name)
    assert simulated and name.effect not in [p.effect.name for p in first.objective.simulated.placements]
    del simulated[:]
    assert backward.refitted_without(problem, with_it, name) is first and simulated == []
    assert backward.refitted_without(problem, replace(with_it), name) is not first, "another fit is asked anew"


def test_a_special_case_that_stands_as_well_is_not_begun_again(
    monkeypatch: pytest.MonkeyPatch, problem: Problem, fit: Fit, simulated: list[int]
) -> None:
    monkeypatch.setattr(decide, "passes", lambda problem, trial: True)
    names = (("directional_efficiency", 0.90), ("load_friction", 0.88))
    trials = [Trial(Candidate(name, ("tilt",)), 0.0, fit, np.zeros(4), closed, True) for name, closed in names]
    assert decide.simplified(problem, fit, np.zeros(4), trials) == trials
    assert simulated == []


def test_a_special_case_whose_strength_has_another_name_is_not_begun_from_nothing(
    monkeypatch: pytest.MonkeyPatch, problem: Problem, fit: Fit, simulated: list[int]
) -> None:
    monkeypatch.setattr(decide, "passes", lambda problem, trial: True)
    monkeypatch.setattr(decide, "judged", lambda *told: pytest.fail("it has no place to begin at"))
    best = Trial(Candidate("torque_speed_limit", ("tilt",)), 0.0, fit, np.zeros(4), 0.9, True)
    assert decide.simplified(problem, fit, np.zeros(4), [best]) == [best]
    assert simulated == []


def test_motions_left_out_need_no_simulation_where_the_fit_is(
    monkeypatch: pytest.MonkeyPatch, problem: Problem, fit: Fit, simulated: list[int]
) -> None:
    """A step of no length is one of those that a careful look tries, and was simulated before."""
    monkeypatch.setattr(left_out, "far_off", lambda problem, fit: True)
    monkeypatch.setattr(left_out, "step_from", lambda fit, rows: np.where(np.arange(len(fit.unit)) == 0, 0.5, 0.0))
    errors = left_out.left_out_errors(problem, fit)
    folds = int(left_out.folds(problem, len(errors)).max()) + 1
    assert simulated == [folds * len(left_out.LENGTHS)]
    own = [float(np.mean(part**2)) for part in fit.objective.per_window(fit.residual)]
    np.testing.assert_allclose(errors, own)  # far steps make everything worse


def test_a_glance_is_enough_where_no_motion_parts_two_models(monkeypatch: pytest.MonkeyPatch, problem: Problem, fit: Fit) -> None:
    seconds, run = [], next_motion.rollout

    def counted(simulated: Any, values: Any, windows: Any, threads: int) -> Any:
        seconds.append(sum(float(w.times[-1]) for w in windows))
        return run(simulated, values, windows, threads)

    monkeypatch.setattr(next_motion, "rollout", counted)
    fits = [having(problem, fit, Candidate("spring", ("tilt",)), {"stiffness": 1e-3 * k, "reference": 0.0}) for k in (1, 2)]
    assert suggest(problem, fits, np.random.default_rng(1)) is None
    assert sum(seconds) <= (1 + len(other_set_ups(problem))) * len(fits) * GLANCED * SECONDS
