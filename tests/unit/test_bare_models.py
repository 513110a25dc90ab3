"""Models as many are published, without a motor's rotor: what is searched has room for what the real drives have."""

import copy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.blind.cases import robot_of
from edream import catalog
from edream.core.effect import Effect
from edream.core.episode import Episode
from edream.diagnosis.naming import is_strange
from edream.diagnosis.nuisance import fit_nuisance
from edream.diagnosis.problem import Settings, nuisance_placements, prepare
from edream.sim.beginning import beginning
from edream.sim.objective import Objective
from edream.sim.robot import RobotModel, load_robot
from edream.sim.rollout import rollout
from edream.sim.scales import rotor_guess, torque_scale
from edream.sim.simulation import Placement, SimulatedRobot
from edream.sim.window import whole

TRUE = {"kp": 35.0, "damping": 2.2, "frictionloss": 1.1, "armature": 0.12}
WRIST = """<mujoco><compiler angle="radian"/><option timestep="0.002" integrator="implicitfast"/><worldbody><body>
  <joint name="wrist" axis="0 0 1" range="-2 2" damping="{damping}" frictionloss="{frictionloss}" armature="{armature}"
   solreffriction="0.004 1" solimpfriction="0.999 0.9999 0.001 0.5 2"/>
  <inertial pos="0 0 0.05" mass="0.2" diaginertia="0.0002 0.0002 0.0001"/></body></worldbody>
  <actuator><position joint="wrist" kp="{kp}"/></actuator></mujoco>"""


def wrist(folder: Path, **numbers: float) -> RobotModel:
    path = folder / f"wrist_{numbers['armature']}.xml"
    path.write_text(WRIST.format(**numbers))
    return load_robot(path)


@pytest.fixture
def bare(tmp_path: Path) -> RobotModel:
    return wrist(tmp_path, kp=40.0, damping=2.0, frictionloss=0.01, armature=0)


def motion(number: int) -> Episode:
    rng = np.random.default_rng(number)
    times = np.arange(0.0, 6.0, 0.02)
    steps = np.repeat(rng.uniform(-1.0, 1.0, 10), 30)[: len(times)]
    command = (np.convolve(np.pad(steps, 5, mode="edge"), np.ones(11) / 11, mode="valid"))[:, None]
    return Episode(f"motion_{number}", ("wrist",), times, np.repeat(command[:1], len(times), axis=0), times, command)


def test_a_rotor_that_the_model_leaves_out_is_found(bare: RobotModel, tmp_path: Path) -> None:
    truth = wrist(tmp_path, **TRUE)
    windows = whole([motion(n) for n in range(6)])
    moved = rollout(SimulatedRobot(truth, ()), np.zeros((1, 0)), windows)
    noise = np.random.default_rng(0)
    episodes = [
        Episode(w.episode.name, w.episode.joints, w.times, m[0] + noise.normal(0.0, 2e-4, m[0].shape), w.times, w.episode.command)
        for w, m in zip(windows, moved, strict=True)
    ]
    problem = prepare(bare, episodes, Settings())
    found = fit_nuisance(problem)
    assert found.rms < 2.0 * problem.floor
    numbers = found.space.mapping(found.values)
    # free motion about an upright axis shows ratios alone; the link is a thousandth of what turns
    ratio = numbers["armature.inertia[wrist]"] / numbers["servo_gain.kp[wrist]"]
    assert ratio == pytest.approx(TRUE["armature"] / TRUE["kp"], rel=0.1)


def test_what_the_model_does_not_say_is_neither_believed_nor_strange(bare: RobotModel) -> None:
    problem = prepare(bare, [motion(n) for n in range(4)], Settings())
    place = next(p for p in nuisance_placements(problem) if p.effect.name == "armature")
    (inertia,) = place.effect.parameters(bare.model, place.targets)
    assert inertia.guessed and not is_strange(inertia, (10.0 * inertia.start, 11.0 * inertia.start))
    fitted = {p.name: p.start for q in nuisance_placements(problem) for p in q.parameters(bare.model)}
    again = next(p for p in nuisance_placements(problem, fitted) if p.effect.name == "armature")
    assert (again.bounds or {})["inertia"]["spread"] == 1.0


def test_a_rotor_that_the_model_has_is_not_guessed(tmp_path: Path) -> None:
    assert rotor_guess(wrist(tmp_path, **TRUE).model, "wrist") == 0.0


def test_a_friction_that_the_servo_could_hardly_overcome_is_not_where_a_search_begins(tmp_path: Path) -> None:
    stuck = wrist(tmp_path, **{**TRUE, "frictionloss": 30.0})
    windows = whole([motion(n) for n in range(3)])
    moved = rollout(SimulatedRobot(wrist(tmp_path, **{**TRUE, "armature": 0.11}), ()), np.zeros((1, 0)), windows)
    episodes = [replace(w.episode, position=m[0]) for w, m in zip(windows, moved, strict=True)]
    for robot, most in ((stuck, 4.0), (wrist(tmp_path, **{**TRUE, "armature": 0.13}), TRUE["frictionloss"])):
        simulated = SimulatedRobot(robot, (Placement(catalog.load("effects", "coulomb", Effect), ("wrist",)),))
        begun = beginning(Objective(simulated, whole(episodes)))
        assert 0.0 < begun[0] <= most and (robot is stuck or begun[0] == most)


def test_a_damping_that_the_model_leaves_out_is_guessed(tmp_path: Path) -> None:
    effect = catalog.load("effects", "viscous", Effect)
    (none,) = effect.parameters(wrist(tmp_path, **{**TRUE, "damping": 0}).model, ("wrist",))
    (some,) = effect.parameters(wrist(tmp_path, **{**TRUE, "armature": 0.1}).model, ("wrist",))
    assert none.guessed and 0.3 < none.start < 3.0
    assert not some.guessed and some.start == TRUE["damping"]


def test_a_torque_scale_follows_a_model_that_was_changed() -> None:
    robot = robot_of("pan_tilt")
    assert robot is not None
    model = copy.copy(robot.model)
    before = torque_scale(model, "tilt")
    assert torque_scale(model, "tilt") == before
    model.body_mass[:] *= 3.0
    model.body_inertia[:] *= 3.0
    assert torque_scale(model, "tilt") > 1.5 * before


def test_a_spring_at_a_light_wrist_may_be_as_stiff_as_its_servo_can_still_work_against() -> None:
    """One of 1.5 N m/rad beside a servo of 20 was beyond a box that only knew how little gravity asks for, and had no name."""
    robot, spring = robot_of("arm6"), catalog.load("effects", "spring", Effect)
    assert robot is not None
    highest = {joint: spring.parameters(robot.model, (joint,))[0].high for joint in ("joint2", "joint6")}
    assert highest["joint6"] == 15.0 > 50.0 * torque_scale(robot.model, "joint6"), "half of the gain"
    assert highest["joint2"] == 110.0 > 4.0 * torque_scale(robot.model, "joint2")
    assert all(probe["stiffness"] < 0.2 for probe in spring.probes(robot.model, ("joint6",))), "probes stay small"
