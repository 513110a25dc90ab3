"""A mass that pulls alike from two links is said to be on the outer one."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from edream.catalog import load
from edream.core.effect import Effect
from edream.diagnosis.candidates import Candidate
from edream.diagnosis.descent import polish
from edream.diagnosis.left_out import left_out_errors
from edream.diagnosis.nuisance import fit_nuisance
from edream.diagnosis.outwards import outermost
from edream.diagnosis.problem import Settings, prepare
from edream.diagnosis.screen import Scored
from edream.diagnosis.trials import refit
from edream.reality.truth import draw
from edream.sim.robot import RobotModel
from tests.stand_in import episodes_of

ROBOT = RobotModel(
    "crane",
    """<mujoco model="crane">
      <compiler angle="radian" autolimits="true"/>
      <option timestep="0.002" integrator="implicitfast"/>
      <default><joint axis="0 1 0" damping="0.3" frictionloss="0.05" armature="0.02"/></default>
      <worldbody>
        <body name="tower" pos="0 0 0.1">
          <joint name="lean" range="-1.2 1.2"/>
          <inertial pos="0 0.01 0.15" mass="0.8" diaginertia="0.004 0.004 0.001"/>
          <body name="boom" pos="0 0 0.3">
            <joint name="lift" range="-1.5 1.5"/>
            <inertial pos="0.25 0 0" mass="0.6" diaginertia="0.001 0.004 0.004"/>
            <body name="flange" pos="0.3 0 0.02">
              <joint name="roll" axis="1 0 0" range="-2 2"/>
              <inertial pos="0.04 0.01 0" mass="0.2" diaginertia="0.0003 0.0003 0.0003"/>
              <site name="ee" pos="0.08 0 0"/>
            </body>
          </body>
        </body>
      </worldbody>
      <actuator>
        <position name="lean" joint="lean" kp="60" kv="2" forcerange="-30 30"/>
        <position name="lift" joint="lift" kp="40" kv="1" forcerange="-20 20"/>
        <position name="roll" joint="roll" kp="20" kv="0.5" forcerange="-10 10"/>
      </actuator>
    </mujoco>""",
    {},
    "ee",
)
AXIS = {"boom": (0.35, 0.0, 0.02), "flange": (0.05, 0.0, 0.0)}  # one point of the roll axis from either link
BOOM, FLANGE = Candidate("payload", ("boom",)), Candidate("payload", ("flange",))


@pytest.mark.parametrize(
    ("hung", "place", "said"),
    [
        ("flange", {"x": 0.05, "y": 0.0, "z": 0.0}, FLANGE),  # on the axis, where the boom would pull as well
        ("boom", {"x": 0.20, "y": 0.06, "z": 0.05}, BOOM),  # beside it: from the flange it would turn with it
    ],
)
def test_a_mass_is_on_the_outermost_link_from_which_it_does_the_same(hung: str, place: dict[str, float], said: Candidate) -> None:
    truth = draw(ROBOT, ["payload"], np.random.default_rng(2), 0.1, (hung,))
    truth = replace(truth, effects=(replace(truth.effects[0], values={"mass": 0.3, **place}),))
    problem = prepare(ROBOT, episodes_of(ROBOT, truth, 5, 5, 5.0), Settings(threads=1))
    fit = fit_nuisance(problem)
    errors = left_out_errors(problem, fit)
    taken = refit(problem, fit, errors, Scored(BOOM, {"mass": 0.2, "x": 0.3, "y": 0.0, "z": 0.0}, 0.5))
    assert taken.fit.rms < 2.0 * problem.floor  # from the boom it is met in both
    trial, ended, same = outermost(problem, errors, taken, polish(taken.fit))
    assert trial.candidate == said and same == {BOOM} - {said}
    assert ended.space.mapping(ended.values)[f"payload.mass[{said.targets[0]}]"] == pytest.approx(0.3, rel=0.05)
    assert ended.rms <= 1.02 * taken.fit.rms


def test_a_mass_hangs_at_one_place_of_the_world_from_every_link() -> None:
    effect, model = load("effects", "payload", Effect), ROBOT.model
    moved = effect.on_link(model, {"mass": 0.4, "x": 0.35, "y": 0.0, "z": 0.02}, "boom", "flange")
    assert moved == pytest.approx({"mass": 0.4, "x": 0.05, "y": 0.0, "z": 0.0})
    assert load("effects", "spring", Effect).on_link(model, {}, "boom", "flange") is None
    data = mujoco.MjData(model)
    data.qpos[:] = 0.4, 0.6, 1.1
    mujoco.mj_kinematics(model, data)
    boom, flange = (data.body(link).xpos + data.body(link).xmat.reshape(3, 3) @ point for link, point in AXIS.items())
    assert boom == pytest.approx(flange)


def test_what_acts_on_joints_stays_where_it_is() -> None:
    truth = draw(ROBOT, ["parallel_spring"], np.random.default_rng(2), 0.1, ("lift",))
    problem = prepare(ROBOT, episodes_of(ROBOT, truth, 5, 4, 4.0), Settings(threads=1))
    fit = fit_nuisance(problem)
    errors = left_out_errors(problem, fit)
    taken = refit(problem, fit, errors, Scored(Candidate("spring", ("lift",)), {"stiffness": 1.0, "reference": 0.0}, 0.5))
    assert outermost(problem, errors, taken, taken.fit) == (taken, taken.fit, frozenset())
