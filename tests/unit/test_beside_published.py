"""What usual numbers have made up for, begun beside published ones."""

import numpy as np
import pytest

from benchmarks.blind.cases import robot_of
from edream.diagnosis.candidates import Candidate
from edream.diagnosis.nearest import from_nearest
from edream.diagnosis.nuisance import fit_nuisance
from edream.diagnosis.problem import Settings, prepare
from edream.diagnosis.screen import Scored
from edream.diagnosis.starts import in_all_strengths_beside_published
from edream.diagnosis.trials import refitted
from edream.reality.truth import draw
from tests.stand_in import episodes_of


def test_a_lag_that_damping_and_inertia_have_made_up_for_is_found_beside_published_numbers() -> None:
    robot = robot_of("pan_tilt")
    assert robot is not None
    truth = draw(robot, ("actuator_lag",), np.random.default_rng(1), 0.3, ())
    episodes = episodes_of(robot, truth, 1)
    problem = prepare(robot, episodes, Settings())
    fit = fit_nuisance(problem)
    one = Scored(Candidate("actuator_lag", truth.effects[0].targets), {"time": 0.001}, 0.0)
    plainly = from_nearest(problem, fit, one, in_all_strengths_beside_published, 6)
    weakly = refitted(problem, fit, one, 6)
    name = f"actuator_lag.time[{truth.effects[0].targets[0]}]"
    assert plainly.rms < problem.floor < weakly.rms
    assert plainly.space.mapping(plainly.values)[name] == pytest.approx(truth.effects[0].values["time"], rel=0.1)
