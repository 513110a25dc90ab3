"""Out of false valleys: a joint that is off is led elsewhere, and a candidate begins again beside published numbers."""

from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from edream.core.parameters import Parameter, ParameterSpace
from edream.diagnosis import ends, valleys
from edream.diagnosis.candidates import Candidate
from edream.diagnosis.descent import Fit
from edream.diagnosis.problem import Problem
from edream.diagnosis.valleys import better_place, groups_off, out_of_false_valleys

FLOOR = 1.0
TRUE = {"pan": np.array([0.62, 0.35]), "tilt": np.array([0.5, 0.5])}


@dataclass
class Rough:
    """Residuals of two joints over two numbers each, with ripples about 0.05 of the box apart: every descent ends in the first."""

    simulated: Any = field(
        default_factory=lambda: SimpleNamespace(
            space=ParameterSpace(
                tuple(
                    Parameter(f"{name}[{joint}]", "1", 0.0, 1.0, 0.5, spread=0.3)
                    for joint in TRUE
                    for name in ("servo_gain.kp", "viscous.damping")
                )
            )
        )
    )
    windows: tuple[Any, ...] = (SimpleNamespace(times=np.array([0.0, 10.0]), episode=SimpleNamespace(conditions={})),)
    acts_on: Any = field(default_factory=lambda: np.array([[True, False], [True, False], [False, True], [False, True]]))
    step: float = 1e-3

    def residuals(self, values: np.ndarray) -> np.ndarray:
        out = []
        for one in np.atleast_2d(values):
            away = [one[:2] - TRUE["pan"], one[2:] - TRUE["tilt"]]
            errors = [0.3 + 20.0 * np.abs(a).max() + 0.5 * np.abs(np.sin(60.0 * a)).sum() for a in away]
            out.append(np.tile(errors, 40))
        return np.array(out)


def fit_at(unit: list[float]) -> Fit:
    objective: Any = Rough()
    residual = objective.residuals(np.array(unit))[0]
    return Fit(objective, np.array(unit), residual, np.zeros((len(residual), 4)), 1.0)


def problem(*shared: tuple[str, ...]) -> Problem:
    told: Any = SimpleNamespace(floor=FLOOR, joints=("pan", "tilt"), shared=shared, settings=SimpleNamespace(seed=0, threads=1))
    return told


@pytest.fixture(autouse=True)
def all_motions(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(valleys, "thinned", lambda fit, seconds: fit)


def test_the_joint_that_is_off_is_led_through_the_ripples_and_the_other_stays() -> None:
    stuck = fit_at([0.5, 0.5, 0.5, 0.5])
    assert groups_off(problem(("pan",), ("tilt",)), stuck) == [("pan",)]
    place = better_place(problem(("pan",), ("tilt",)), stuck, [("pan",)])
    assert place is not None
    np.testing.assert_array_equal(place[2:], stuck.unit[2:])
    assert np.abs(place[:2] - TRUE["pan"]).max() < 0.03
    again = better_place(problem(("pan",), ("tilt",)), stuck, [("pan",)])
    np.testing.assert_array_equal(place, again)


def test_only_servos_at_their_limit_and_joints_that_are_off_are_searched() -> None:
    stuck, there = fit_at([0.5, 0.5, 0.5, 0.5]), fit_at([0.62, 0.35, 0.5, 0.5])
    assert groups_off(problem(), stuck) == groups_off(problem(("tilt",)), stuck) == []
    assert groups_off(problem(("pan",), ("tilt",)), there) == []
    assert better_place(problem(("pan",)), there, [("pan",)]) is None, "there is no better place"
    assert out_of_false_valleys(problem(), stuck) is stuck


def test_a_joint_that_is_off_is_seen_where_the_mean_is_at_the_floor() -> None:
    fit = fit_at([0.62, 0.35, 0.5, 0.5])
    hidden = replace(fit, residual=np.tile([0.2, 1.52], 40))  # 1.08 in the mean
    assert groups_off(problem(("pan",), ("tilt",)), hidden) == [("tilt",)]
    assert groups_off(problem(("pan",), ("tilt",)), replace(fit, residual=np.tile([1.05, 1.1], 40))) == []


def test_a_candidate_that_leaves_a_gap_begins_again_beside_published_numbers_and_keeps_the_better(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    begun: list[np.ndarray] = []
    published = np.array([0.62, 0.35, 0.5, 0.5])
    monkeypatch.setattr(ends, "as_published", lambda problem, names, values, joints: np.where([1, 1, 0, 0], published, values))
    monkeypatch.setattr(ends, "begin", lambda objective, unit: begun.append(unit) or fit_at(list(unit)))
    monkeypatch.setattr(ends, "descend", lambda fit, fresh, iterations: fit)
    stuck, good, worse = fit_at([0.3, 0.3, 0.5, 0.5]), fit_at([0.62, 0.35, 0.5, 0.5]), fit_at([0.63, 0.36, 0.5, 0.5])
    candidates = [Candidate("spring", ("pan",)), Candidate("quadratic_drag", ("pan",)), Candidate("gravity_tilt", ())]
    found = ends.begun_again(problem(("pan",)), [stuck, good, worse], candidates)
    assert found[0].rms == pytest.approx(good.rms) and found[1] is good, "what leaves no gap stays"
    assert found[2] is worse, "what acts on no joint has no published numbers to begin beside"
    assert len(begun) == 1
    there = problem(("pan",))
    assert ends.off_on(there, stuck, frozenset({"pan"})) > 3.0 > 0.5 > ends.off_on(there, stuck, frozenset({"tilt"}))
