"""Two effects of one joint are found at once in short stretches, where neither is found before the other on whole motions."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import edream
from edream.diagnosis.candidates import library
from edream.diagnosis.left_out import far_off, left_out_errors
from edream.diagnosis.nuisance import fit_nuisance, with_shares
from edream.diagnosis.problem import Settings, prepare
from edream.diagnosis.shooting import both_at_once, without_past
from edream.reality.truth import draw
from edream.sim.robot import load_robot
from tests.stand_in import episodes_of
from tests.still_problem import still_problem

HEAD = load_robot(Path(edream.__file__).parent / "robots" / "pan_tilt.xml", site="ee")
EFFECTS = ("torque_limit", "spring", "constant_torque", "dead_zone", "sensor_delay")


def test_a_weak_motor_and_a_spring_beside_it_are_found_together() -> None:
    truth = draw(HEAD, ("torque_saturation", "parallel_spring"), np.random.default_rng(3), 0.3, ("tilt", "tilt"))
    problem = prepare(HEAD, episodes_of(HEAD, truth, 3, 6, 5.0), Settings(effects=EFFECTS, threads=1))
    problem, usual = with_shares(problem, fit_nuisance(problem))
    assert far_off(problem, usual)
    pair = both_at_once(problem, usual, left_out_errors(problem, usual))
    assert pair is not None
    assert {pair.first.candidate.label, pair.second.candidate.label} == {"torque_limit[tilt]", "spring[tilt]"}
    assert pair.second.sure and pair.second.fit.rms < 1.1 * problem.floor < 0.1 * pair.first.fit.rms
    found, (limit, spring) = pair.second.fit.space.mapping(pair.second.fit.values), truth.effects
    assert found["torque_limit.torque[tilt]"] == pytest.approx(limit.values["torque"], rel=0.1)
    assert found["spring.stiffness[tilt]"] == pytest.approx(spring.values["stiffness"], rel=0.1)


def test_there_are_no_two_where_there_is_one_effect_to_look_for() -> None:
    problem = still_problem()
    problem = replace(problem, settings=replace(problem.settings, effects=("spring",), threads=1))
    fit = fit_nuisance(problem)
    assert both_at_once(problem, fit, left_out_errors(problem, fit)) is None


def test_what_repeats_readings_is_not_looked_for_in_stretches_that_begin_at_them() -> None:
    problem = still_problem()
    kept = [effect.name for effect in library(without_past(problem))]
    assert {effect.name for effect in library(problem)} - set(kept) == {"sensor_delay"}
