"""Every shipped robot is one that all of edream can work with."""

import re
from pathlib import Path

import mujoco
import numpy as np
import pytest

import edream
from edream.sim.robot import RobotModel, load_robot

FOLDER = Path(edream.__file__).parent / "robots"
ROBOTS = sorted(path.stem for path in FOLDER.glob("*.xml"))


@pytest.fixture(params=ROBOTS)
def robot(request: pytest.FixtureRequest) -> RobotModel:
    return load_robot(FOLDER / f"{request.param}.xml", site="left_ee" if request.param == "cobot" else "ee")


def test_the_shipped_robots_are_these() -> None:
    assert ROBOTS == ["arm6", "cobot", "pan_tilt"]


def test_every_joint_has_one_position_servo_and_a_finite_range(robot: RobotModel) -> None:
    model = robot.model
    assert model.nu == model.nv == len(set(robot.joints))
    assert np.asarray(model.jnt_limited).all()
    assert (np.ptp(model.jnt_range, axis=1) < 2.0 * np.pi).all() and (np.ptp(model.jnt_range, axis=1) > 0.05).all()
    np.testing.assert_array_equal(model.actuator_gainprm[:, 0], -model.actuator_biasprm[:, 1])


def test_every_joint_moves_where_it_is_told_without_ringing(robot: RobotModel) -> None:
    model = robot.model
    data = mujoco.MjData(model)
    low, high = model.jnt_range.T
    data.qpos[:] = 0.5 * (low + high)
    data.ctrl[:] = 0.5 * (low + high) + 0.05 * (high - low)
    for _ in range(1500):
        mujoco.mj_step(model, data)
    assert np.abs(data.qvel).max() < 1e-2
    assert (np.abs(data.qpos - data.ctrl) < 0.05 * (high - low)).all()


def test_stuck_joints_do_not_creep(robot: RobotModel) -> None:
    model = robot.spec().compile()
    model.opt.gravity[:] = 0.0
    model.actuator_gainprm[:], model.actuator_biasprm[:] = 0.0, 0.0
    data = mujoco.MjData(model)
    data.qpos[:] = model.jnt_range.mean(axis=1)
    data.qfrc_applied[:] = 0.8 * model.dof_frictionloss
    start = data.qpos.copy()
    for _ in range(1000):
        mujoco.mj_step(model, data)
    assert np.abs(data.qpos - start).max() < 1e-3


def test_the_two_arms_of_the_cobot_are_arm6() -> None:
    arm, cobot = (load_robot(FOLDER / f"{name}.xml").model for name in ("arm6", "cobot"))
    for side in ("left_", "right_"):
        for joint in range(arm.njnt):
            twin = cobot.joint(side + arm.joint(joint).name)
            assert twin.range.tolist() == arm.jnt_range[joint].tolist()
            assert twin.armature[0] == arm.dof_armature[joint] and twin.frictionloss[0] == arm.dof_frictionloss[joint]
            assert cobot.actuator(side + arm.actuator(joint).name).gainprm[0] == arm.actuator_gainprm[joint, 0]
        for body in range(1, arm.nbody):
            twin = cobot.body(side + arm.body(body).name)
            assert twin.mass[0] == arm.body_mass[body] and twin.inertia.tolist() == arm.body_inertia[body].tolist()


def test_the_files_stand_alone_and_speak_radians(robot: RobotModel) -> None:
    assert not robot.assets
    assert re.search(r'<compiler angle="radian"', robot.mjcf) and "file=" not in robot.mjcf
