"""Robots whose joints are driven by torque or by speed instead of by a position, or that drive more than was recorded."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import mujoco
import numpy as np
import pytest

from edream.calibration.errors import before_and_after, perfect_tracking, summary
from edream.catalog import load
from edream.core.effect import Effect, State, holds_position
from edream.core.episode import Episode
from edream.core.errors import EdreamError
from edream.diagnosis.candidates import Candidate, library, rounds
from edream.diagnosis.next_motion import suggest
from edream.diagnosis.nuisance import fit_nuisance
from edream.diagnosis.problem import Problem, Settings, prepare
from edream.diagnosis.screen import screen
from edream.effects.load_friction import load_friction
from edream.sim.robot import RobotModel, load_robot
from edream.sim.rollout import rollout
from edream.sim.servo import asked_positions
from edream.sim.simulation import Placement, SimulatedRobot
from edream.sim.window import whole
from edream.stages.fit import comparison
from edream.stages.replay import replay

POSITION_ONLY = {
    "backlash", "compliance", "dead_zone", "derivative_gain", "gear_ratio", "integral_action", "slew_limit",
}  # fmt: skip
SERVOS = {
    "motor": '<motor joint="a"/><motor joint="b"/>',
    "velocity": '<velocity joint="a" kv="6"/><velocity joint="b" kv="3"/>',
    "mixed": '<motor joint="a"/><position joint="b" kp="20"/>',
}


def _robot(kind: str, spring: float = 0.0, step: float = 0.002) -> RobotModel:
    """Two links that hang, the upper one perhaps with a spring."""
    return RobotModel(
        kind,
        f"""<mujoco><compiler angle="radian"/><option timestep="{step}" integrator="implicitfast"/><worldbody>
        <body><joint name="a" axis="0 1 0" damping="0.4" frictionloss="0.05" armature="0.02" stiffness="{spring}"/>
          <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.03" mass="0.6"/>
          <body name="lower" pos="0 0 -0.3"><joint name="b" axis="0 1 0" damping="0.2" frictionloss="0.03" armature="0.01"/>
            <geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.02" mass="0.3"/></body></body></worldbody>
        <actuator>{SERVOS[kind]}</actuator></mujoco>""",
    )


def _recorded(kind: str, spring: float, count: int = 5, seconds: float = 5.0) -> list[Episode]:
    """Motions of the robot under torques or speeds that swing, by MuJoCo at a finer step, with noise."""
    robot = _robot(kind, spring, 5e-4)
    model = robot.spec().compile()
    out = []
    for number in range(count):
        rng = np.random.default_rng(number)
        times = np.arange(0.0, seconds, 0.02)
        waves = np.sin(times[:, None, None] * rng.uniform(1.0, 5.0, (2, 3)) + rng.uniform(0.0, 6.0, (2, 3))).sum(axis=2)
        command = waves * (np.array([0.5, 0.15]) if kind == "motor" else 0.5)
        data, position = mujoco.MjData(model), np.empty((len(times), 2))
        for row, told in enumerate(command):
            position[row] = data.qpos
            data.ctrl[:] = told
            mujoco.mj_step(model, data, 40)
        position += rng.normal(0.0, 3e-4, position.shape)
        out.append(Episode(f"motion_{number}", robot.joints, times, position, times, command))
    return out


def _problem(kind: str, spring: float, effects: tuple[str, ...] = ()) -> Problem:
    return prepare(_robot(kind), _recorded(kind, spring), Settings(effects=effects))


@pytest.mark.parametrize("kind", ["motor", "velocity"])
def test_a_command_is_worth_what_the_gain_says(kind: str) -> None:
    robot = _robot(kind)
    place = Placement(load("effects", "servo_gain", Effect), ("a",))
    (gain,) = place.parameters(robot.model)
    assert not holds_position(robot.model, "a") and gain.name == "servo_gain.gain[a]"
    assert gain.start == (1.0 if kind == "motor" else 6.0)
    windows = whole([replace(one, command=np.ones_like(one.command)) for one in _recorded(kind, 0.0, 1)], None)
    simulated = SimulatedRobot(robot, (place,))
    (weak,), (strong,) = (rollout(simulated, np.array([[gain.start * factor]]), windows) for factor in (0.5, 1.5))
    assert strong[0, -1, 0] > weak[0, -1, 0] + 0.1


@pytest.mark.parametrize("kind", ["motor", pytest.param("velocity", marks=pytest.mark.slow)])
def test_the_score_test_points_at_a_spring_of_a_robot_under_torque_or_speed(kind: str) -> None:
    looked_at = _problem(kind, 1.5)
    names = {candidate.effect for one in rounds(looked_at, library(looked_at)) for candidate in one}
    assert not names & POSITION_ONLY and {"spring", "payload", "stribeck", "actuator_delay", "torque_limit"} <= names
    assert Candidate("payload", ("a_link",)) in [c for one in rounds(looked_at, library(looked_at)) for c in one]  # it has no name
    scored = screen(looked_at, fit_nuisance(looked_at))
    spring = next(one for one in scored if one.candidate.effect in ("spring", "hardening_spring"))
    assert spring.candidate.targets == ("a",) and spring.share > 0.99 * scored[0].share
    before = {one.candidate.effect for one in scored[: scored.index(spring)]}
    assert before <= {"payload"}  # which a swinging link's spring is hardly told from to first order


def test_where_only_some_joints_hold_a_position_the_others_are_spared() -> None:
    looked_at = _problem("mixed", 0.0, tuple(POSITION_ONLY))
    asked = [candidate for one in rounds(looked_at, library(looked_at)) for candidate in one]
    assert {c.targets for c in asked} == {("b",)} and {c.effect for c in asked} == POSITION_ONLY
    assert suggest(looked_at, [], np.random.default_rng(0)) is None
    with pytest.raises(EdreamError, match="a, b are tied, but only some hold a position"):
        load("effects", "servo_gain", Effect).parameters(looked_at.robot.model, ("a", "b"))
    assert Candidate("dead_zone", ("a",)) not in asked


@pytest.mark.parametrize("kind", ["motor", "velocity", "mixed"])
def test_a_torque_or_a_speed_is_no_position_to_be_at(kind: str) -> None:
    """A robot that tracked its torques perfectly was said to be off by 1.24 rad."""
    robot, episodes = _robot(kind), _recorded(kind, 0.0, 1)
    simulated, windows = SimulatedRobot(robot, ()), whole(episodes, None)
    assert perfect_tracking(simulated, episodes, np.ones(2, dtype=bool), None) is None
    judge = before_and_after(*([summary(simulated, [w.measured for w in windows], windows, np.ones(2, dtype=bool))] * 2), None)
    assert [row["model"] for row in comparison(judge)] == ["published", "calibrated"]
    assert replay(robot, episodes)["perfect_tracking_rmse_rad"] is None
    asked = asked_positions(robot.model, robot.joints, episodes[0].command)
    assert np.isnan(asked[:, 0]).all() and np.isfinite(asked[:, 1]).all() == (kind == "mixed")


HAND = """<mujoco><worldbody><body name="upper"><joint name="a" axis="0 1 0"/><geom size="0.03"/>
  <body name="hand" pos="0 0 -0.3"><joint name="b" axis="0 1 0"/><geom size="0.03"/>
    <body name="left"><joint name="left" type="slide" axis="0 1 0"/><geom size="0.01" pos="0 0.05 0"/></body>
    <body name="right"><joint name="right" type="slide" axis="0 -1 0"/><geom size="0.01" pos="0 -0.05 0"/></body></body></body>
  </worldbody><tendon><fixed name="fingers"><joint joint="left" coef="0.5"/><joint joint="right" coef="0.5"/></fixed></tendon>
  <actuator><position name="grip" tendon="fingers" kp="50"/><position joint="b" kp="20"/><position joint="a" kp="40"/>
    <position joint="left" kp="5"/></actuator></mujoco>"""


def test_a_grippers_tendon_is_no_joint_and_joints_that_were_not_recorded_may_be_left_out(tmp_path: Path) -> None:
    path = tmp_path / "hand.xml"
    path.write_text(HAND)
    assert load_robot(path).joints == ("b", "a", "left")
    robot = load_robot(path, recorded=["a", "b"])
    assert robot.joints == ("b", "a")
    times = np.arange(0.0, 2.0, 0.02)
    command = np.stack([0.3 * np.sin(3.0 * times), 0.2 * np.cos(2.0 * times)], axis=1)
    bare = SimulatedRobot(robot, ())
    (moved,) = rollout(bare, np.zeros((1, 0)), whole([Episode("one", robot.joints, times, command, times, command)], None))
    assert np.isfinite(moved).all() and np.ptp(moved[0], axis=0).min() > 0.1
    with pytest.raises(EdreamError, match=r"no driven joint \(named in robot.joints\) 'right'.*a, b, left"):
        _ = load_robot(path, recorded=["a", "right"]).joints
    with pytest.raises(EdreamError, match="no actuator on a hinge or slide joint"):
        _ = RobotModel("hand", HAND[: HAND.index("<position joint")] + "</actuator></mujoco>").joints


def test_friction_grows_with_the_force_of_its_own_servo_behind_an_actuator_of_several_outputs():
    still, forces = np.zeros((1, 1)), np.array([[9.0, 9.0, 9.0, -2.0]])
    state = SimpleNamespace(gear_torque=still, actuator_force=forces, friction=np.zeros((1, 1)))
    index = {"dof": 0, "drive": 0, "actuator": 1, "force": 3}
    load_friction(cast(State, state), index, {"slope": 0.5, "motor_share": 1.0})
    assert state.friction.tolist() == [[1.0]]
