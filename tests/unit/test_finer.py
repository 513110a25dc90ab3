"""Friction that does not grow in proportion to the load is said to do so, and nothing else is named for what its form leaves."""

from collections.abc import Mapping
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.blind.cases import robot_of
from edream.diagnosis import finer
from edream.diagnosis.candidates import Candidate, placement, standing
from edream.diagnosis.descent import begin, polish
from edream.diagnosis.finer import finest, with_finer, with_plain
from edream.diagnosis.left_out import left_out_errors
from edream.diagnosis.naming import numbers_of
from edream.diagnosis.nuisance import fit_nuisance, published
from edream.diagnosis.problem import Problem, Settings, prepare
from edream.diagnosis.screen import Scored
from edream.diagnosis.trials import Trial, refit
from edream.reality import effects
from edream.reality.friction_effects import LoadFriction
from edream.reality.plant import Moment
from edream.reality.truth import draw
from edream.sim.simulation import SimulatedRobot
from tests.stand_in import episodes_of

LOAD = Candidate("load_friction", ("tilt",))


class Rising(LoadFriction):
    """Nothing from a light load, and ever more from a heavy one."""

    def dry(self, up: np.ndarray, down: np.ndarray, now: Moment) -> tuple[np.ndarray, np.ndarray]:
        more = self.of("share") * np.square(now.load)
        return up + more, down + more


def _kinds(rising: bool) -> Mapping[str, effects.Kind]:
    proportional = effects.KINDS["load_friction"]
    own = effects.Kind(Rising, "loaded", {"share": 0.0}, lambda r, s: {"share": 1.0})
    return {**effects.KINDS, "load_friction": own if rising else proportional}


def _problem(hidden: list[str], motions: int, seconds: float) -> Problem:
    """A pan-tilt head that hides effects on its tilt joint, recorded for so long [s]."""
    robot = robot_of("pan_tilt")
    assert robot is not None
    truth = draw(robot, hidden, np.random.default_rng(5), 0.3, ("tilt",) * len(hidden))
    episodes = episodes_of(robot, truth, 5, motions, seconds)
    return prepare(robot, episodes, Settings())


@pytest.mark.parametrize("rising", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_friction_that_rises_faster_than_the_load_has_one_number_more(monkeypatch: pytest.MonkeyPatch, rising: bool) -> None:
    monkeypatch.setattr(effects, "KINDS", _kinds(rising))
    problem = _problem(["load_friction"], 6, 5.0)
    fit = fit_nuisance(problem)
    errors = left_out_errors(problem, fit)
    plain = refit(problem, fit, errors, Scored(LOAD, {"slope": 0.05, "motor_share": 0.1, "inside": 0.8}, 0.5))
    before = polish(plain.fit)
    taken, ended = with_finer(problem, errors, plain, before)
    values, intervals, units = numbers_of(problem, ended, standing(problem, LOAD, ended.objective.simulated))
    assert ("quadratic" in values) is rising
    if rising:
        assert units["quadratic"] == "1/(N m)" and intervals["quadratic"][0] > 0.0
        assert taken.closed > plain.closed and ended.rms < 0.7 * before.rms
    else:
        assert ended is before and taken is plain


@pytest.mark.parametrize(("quadratic", "missed", "stays"), [(0.8, False, True), (0.01, False, False), (0.01, True, True)])
def test_a_further_number_that_may_be_none_beside_a_later_effect_goes_again_unless_it_is_missed(
    monkeypatch: pytest.MonkeyPatch, quadratic: float, missed: bool, stays: bool
) -> None:
    problem = _problem([], 4, 2.0)
    plain, later = placement(problem, LOAD), placement(problem, Candidate("quadratic_drag", ("pan",)))
    assert plain.effect.finer is not None
    simulated = SimulatedRobot(problem.robot, (replace(plain, effect=plain.effect.finer), later))
    found = simulated.space.mapping(simulated.space.start()) | {"load_friction.quadratic[tilt]": quadratic}
    objective = replace(published(problem), simulated=simulated)
    fit = replace(begin(objective, simulated.space.to_unit(simulated.space.vector(found))), ended=True)
    monkeypatch.setattr(finer, "is_away", lambda fit, parameter: fit.space.mapping(fit.values)[parameter.name] > 0.5)
    monkeypatch.setattr(finer, "closes_more", lambda problem, smaller, whole: missed and whole is fit)
    assert with_plain(problem, fit, [LOAD]) is fit, "nothing came later"
    ended = with_plain(problem, fit, [LOAD, Candidate("quadratic_drag", ("pan",))])
    assert (ended is fit) is stays
    left = [name for name in fit.space.names if stays or "quadratic[tilt]" not in name]
    assert list(ended.space.names) == left and any("quadratic_drag" in name for name in left)


@pytest.mark.parametrize(
    ("rival", "rms", "left_out", "is_taken"),
    [
        ("load_friction", 0.8, 0.9, True),
        ("load_friction", 0.99, 0.9, False),
        ("load_friction", 0.8, 1.1, False),
        ("spring", 0.8, 0.9, False),
    ],
)
def test_a_rival_is_taken_whose_finer_form_does_better_in_the_fit_and_on_motions_left_out(
    monkeypatch: pytest.MonkeyPatch, rival: str, rms: float, left_out: float, is_taken: bool
) -> None:
    """Friction with the square of the load is asked for beside an efficiency that seemed to differ by direction."""

    def trial(effect: str, closed: float, squared: float) -> Trial:
        return Trial(Candidate(effect, ("tilt",)), 0.1, SimpleNamespace(rms=1.0), np.full(4, squared), closed, True)

    problem = SimpleNamespace(floor=0.01, settings=SimpleNamespace(gain=0.1))
    taken, plain, curved = trial("directional_efficiency", 0.6, 1.0), trial(rival, 0.55, 1.1), trial(rival, 0.65, left_out)
    ended, there = SimpleNamespace(rms=1.0), SimpleNamespace(rms=rms)
    monkeypatch.setattr(finer, "arrived", lambda problem, before, one: one.fit)
    monkeypatch.setattr(finer, "polish", lambda fit: fit)
    monkeypatch.setattr(finer, "is_left_on", lambda problem, fit, joints: True)
    monkeypatch.setattr(finer, "stands", lambda problem, candidate, fit: True)
    monkeypatch.setattr(
        finer, "in_finer_form", lambda problem, errors, one, fit: (curved, there, one.errors) if one is plain else None
    )
    found = finest(problem, ended, np.ones(4), taken, ended, [plain])
    assert found == ((curved, there) if is_taken else (taken, ended))
