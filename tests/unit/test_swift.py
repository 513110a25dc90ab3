"""Searches solve dry friction by Gauss-Seidel: Newton's motion, and only where friction is all there is; one tree is one island."""

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np

from edream import catalog
from edream.core.effect import Effect
from edream.core.episode import Episode
from edream.sim.robot import RobotModel, load_robot
from edream.sim.rollout import rollout
from edream.sim.simulation import Placement, SimulatedRobot
from edream.sim.window import whole

ARM = load_robot(Path(__file__).resolve().parents[2] / "edream" / "robots" / "arm6.xml", site="ee")
NEWTON, PGS = int(mujoco.mjtSolver.mjSOL_NEWTON), int(mujoco.mjtSolver.mjSOL_PGS)
ISLAND = int(mujoco.mjtDisableBit.mjDSBL_ISLAND)


def rubbing(robot: RobotModel = ARM) -> SimulatedRobot:
    return SimulatedRobot(robot, (Placement(catalog.load("effects", "coulomb", Effect), robot.joints),))


def waving() -> Episode:
    times = np.arange(0.0, 3.0, 0.02)
    command = np.stack([0.3 * np.sin((1.0 + 0.3 * j) * times) for j in range(len(ARM.joints))], axis=1)
    return Episode("wave", ARM.joints, times, np.zeros_like(command), times, command)


def test_a_search_sees_the_motion_that_a_well_converged_newton_finds() -> None:
    own = rubbing()
    values = own.space.start()[None]
    exact = rubbing(replace(ARM, name="exact"))
    exact.model.opt.tolerance = 1e-12
    found = {name: rollout(one, values, whole([waving()]), threads=1)[0] for name, one in (("swift", own.swift), ("exact", exact))}
    assert own.swift.model.opt.solver == PGS
    assert np.ptp(found["exact"]) > 0.1
    np.testing.assert_allclose(found["swift"], found["exact"], rtol=0.0, atol=1e-6)


def test_a_replay_that_is_reported_keeps_the_solver_of_the_model() -> None:
    assert rubbing().model.opt.solver == NEWTON
    assert rubbing().swift.with_placements(()).model.opt.solver == PGS


def test_a_model_that_can_touch_something_keeps_its_solver(tmp_path: Path) -> None:
    text = (
        "<mujoco><worldbody>{table}<body name='link'><joint name='hinge' axis='0 1 0'/><geom name='rod' size='0.1' mass='1'/>"
        "<site name='ee'/></body></worldbody><actuator><position joint='hinge' kp='1'/></actuator></mujoco>"
    )
    solvers = {}
    for name, table in {"alone": "", "beside": "<geom name='table' type='plane' size='1 1 1' pos='0 0 -1'/>"}.items():
        path = tmp_path / f"{name}.xml"
        path.write_text(text.format(table=table))
        solvers[name] = int(rubbing(load_robot(path, site="ee")).swift.model.opt.solver)
    assert solvers == {"alone": PGS, "beside": NEWTON}


def test_a_model_with_a_slack_gear_keeps_its_solver() -> None:
    backlash = Placement(catalog.load("effects", "backlash", Effect), (ARM.joints[0],))
    assert SimulatedRobot(ARM, (backlash,)).swift.model.opt.solver == NEWTON


def test_the_one_island_of_a_tree_is_not_looked_for_and_moves_to_the_last_bit_as_it_did(tmp_path: Path) -> None:
    own, looked = rubbing().swift, rubbing().swift
    looked.model.opt.disableflags &= ~ISLAND
    assert int(own.model.opt.disableflags) & ISLAND and own.model.ntree == 1
    values, windows = own.space.start()[None], whole([waving()])
    quick, slow = (rollout(one, values, windows, threads=1)[0] for one in (own, looked))
    assert np.ptp(slow) > 0.1
    np.testing.assert_array_equal(quick, slow)
    links = "".join(f"<body name='b{n}'><joint name='j{n}'/><geom size='0.1' pos='0.2 0 0'/></body>" for n in range(2))
    servos = "".join(f"<position joint='j{n}' kp='1'/>" for n in range(2))
    path = tmp_path / "two.xml"
    path.write_text(f"<mujoco><worldbody>{links}</worldbody><actuator>{servos}</actuator></mujoco>")
    assert not int(rubbing(load_robot(path)).swift.model.opt.disableflags) & ISLAND
