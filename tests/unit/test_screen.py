"""The score test: which effect it points at."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.blind.cases import robot_of
from edream.catalog import load
from edream.core.effect import Effect
from edream.diagnosis.nuisance import fit_nuisance
from edream.diagnosis.problem import Settings, prepare
from edream.diagnosis.screen import screen, waves
from edream.reality.truth import draw
from edream.sim.robot import load_robot
from tests.stand_in import episodes_of


@pytest.mark.parametrize("phase", [-2.5, -0.4, 1.0, 3.0])
def test_two_probes_a_quarter_turn_apart_find_a_wave_of_any_phase(phase: float) -> None:
    rng = np.random.default_rng(5)
    turns = rng.normal(size=(4, 300))  # sine and cosine of two wavelengths
    hidden = 2.0 * (np.cos(phase) * turns[2] + np.sin(phase) * turns[3])
    probes = [{"periods": n, "phase": p} for n in (8.0, 10.0) for p in (0.0, np.pi / 2.0)]
    found = waves(load("effects", "cogging", Effect), probes, list(turns), -hidden)
    (_, away), (probe, change) = found
    assert probe["periods"] == 10.0 and probe["phase"] == pytest.approx(phase, abs=0.2)
    assert float(change @ hidden) > 0.99 * np.linalg.norm(change) * np.linalg.norm(hidden)
    assert abs(float(away @ hidden)) < 0.3 * np.linalg.norm(away) * np.linalg.norm(hidden)


def test_the_score_test_points_at_a_torque_limit_far_below_where_a_servo_has_none() -> None:
    robot = robot_of("pan_tilt")
    assert robot is not None
    truth = draw(robot, ("torque_saturation",), np.random.default_rng(21), 0.3, ())
    episodes = episodes_of(robot, truth, 21)
    looked_at = prepare(robot, episodes, Settings(effects=("torque_limit", "quadratic_drag", "load_friction", "stribeck")))
    first = screen(looked_at, fit_nuisance(looked_at))[0]
    assert (first.candidate.effect, first.candidate.targets) == ("torque_limit", truth.effects[0].targets)
    assert first.start["torque"] == pytest.approx(truth.effects[0].values["torque"], rel=0.2)


FOLDING = """<mujoco><worldbody><body name="upper"><joint name="a" axis="0 1 0" damping="0.1" armature="0.02"
    frictionloss="0.05" range="-99 99"/><geom type="capsule" fromto="0 0 0 0.4 0 0" size="0.03"/>
  <body name="lower" pos="0.4 0 0"><joint name="b" axis="0 -1 0" damping="0.1" armature="0.02" frictionloss="0.05" range="-99 99"/>
    <geom type="capsule" fromto="0 0 0 0.4 0 0" size="0.03"/></body></body></worldbody>
  <actuator><position name="a" joint="a" kp="120" kv="4"/><position name="b" joint="b" kp="60" kv="2"/></actuator></mujoco>"""


def test_a_zero_offset_is_asked_of_each_joint_by_itself(tmp_path: Path) -> None:
    """Both joints off at once, each the other way round, leave the outer link where it was, and its load as it was."""
    (tmp_path / "folding.xml").write_text(FOLDING, encoding="utf-8")
    robot = load_robot(tmp_path / "folding.xml")
    truth = draw(robot, ("encoder_offset",), np.random.default_rng(1), 0.3, ())
    episodes = episodes_of(robot, truth, 1)
    looked_at = prepare(robot, episodes, Settings(effects=("encoder_offset", "gear_ratio", "spring", "constant_torque")))
    first = screen(looked_at, fit_nuisance(looked_at))[0]
    assert truth.effects[0].targets == ("b",)
    assert (first.candidate.effect, first.candidate.targets) == ("encoder_offset", ("b",))
    assert first.start["angle"] == pytest.approx(truth.effects[0].values["angle"], rel=0.2)
