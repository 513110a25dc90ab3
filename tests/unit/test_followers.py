"""Joints without an encoder that equalities tie to recorded ones: where a replay, or a picture, finds them."""

from collections.abc import Callable

import mujoco
import numpy as np
import pytest

from edream.core.camera import Camera, looking_at
from edream.core.episode import Episode
from edream.sim.camera import SimulationCamera
from edream.sim.followers import Followers
from edream.sim.open_loop import plain_loop
from edream.sim.robot import RobotModel
from edream.sim.rollout import rollout
from edream.sim.simulation import SimulatedRobot
from edream.sim.touch import never_touches
from edream.sim.window import Window

GRIPPER = RobotModel(
    "gripper",
    """<mujoco><option timestep="0.001" gravity="0 0 0"/><worldbody>
    <body pos="0 0.1 0"><joint name="left" type="slide" axis="0 1 0" armature="0.02"/>
    <geom type="box" size="0.02 0.005 0.05"/></body>
    <body pos="0 -0.1 0"><joint name="right" type="slide" axis="0 1 0"/><geom type="box" size="0.02 0.005 0.05"/></body>
    </worldbody><equality><joint joint1="right" joint2="left" polycoef="0 -1 0 0 0"/></equality>
    <actuator><position joint="left" kp="40" kv="5"/></actuator></mujoco>""",
)
FOUR_BARS = """<mujoco><worldbody>
    <body name="crank"><joint name="crank" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 0.3" size="0.01"/>
    <body name="bar" pos="0 0 0.3"><joint name="bar" axis="0 1 0"/>
    <geom type="capsule" fromto="0 0 0 0.4 0 0" size="0.01"/></body></body>
    <body name="rocker" pos="0.4 0 0"><joint name="rocker" axis="0 1 0"/>
    <geom type="capsule" fromto="0 0 0 0 0 0.3" size="0.01"/></body>
    <body name="loose" pos="0 1 0"><joint name="loose" axis="0 1 0"/><geom size="0.1"/></body>
    </worldbody><equality><connect body1="bar" body2="rocker" anchor="0.4 0 0"/></equality></mujoco>"""


@pytest.mark.parametrize("jacobian", [mujoco.mjtJacobian.mjJAC_DENSE, mujoco.mjtJacobian.mjJAC_SPARSE])
def test_a_chain_is_closed_and_what_is_not_tied_stays(jacobian: int) -> None:
    model = mujoco.MjModel.from_xml_string(FOUR_BARS)
    model.opt.jacobian = jacobian
    chain, (qpos, qvel) = Followers(model, ("crank",)), np.zeros((2, 4))
    assert chain.joints == ["bar", "rocker"]
    qpos[0], qpos[3], qvel[0] = 0.4, 0.2, 1.5
    chain.place(qpos, qvel)
    np.testing.assert_allclose(qpos, [0.4, -0.4, 0.4, 0.2], atol=1e-9)  # a parallelogram
    np.testing.assert_allclose(qvel, [1.5, -1.5, 1.5, 0.0], atol=1e-9)


def test_a_robot_without_equalities_has_none() -> None:
    spec = mujoco.MjSpec.from_string(FOUR_BARS)
    spec.delete(spec.equalities[0])
    assert Followers(spec.compile(), ("crank",)).joints == []


def _recorded() -> Episode:
    model = GRIPPER.spec().compile()
    data, rows = mujoco.MjData(model), []
    command = 0.03 * np.sin(3.0 * 0.02 * np.arange(100))
    for told in command:
        rows.append(data.qpos[:1].copy())
        data.ctrl[0] = told
        mujoco.mj_step(model, data, 20)
    times = 0.02 * np.arange(100)
    return Episode("one", ("left",), times, np.array(rows), times, command[:, None])


def _in_a_batch(window: Window) -> np.ndarray:
    return rollout(SimulatedRobot(GRIPPER, ()), np.zeros((2, 0)), [window], threads=1)[0][1]


def _in_a_loop(window: Window) -> np.ndarray:
    return plain_loop(GRIPPER, lambda _: lambda model, data: None, window)


@pytest.mark.parametrize("replayed", [_in_a_batch, _in_a_loop])
def test_a_replay_from_the_middle_of_a_motion_has_both_fingers_where_they_were(replayed: Callable[[Window], np.ndarray]) -> None:
    window = Window(_recorded(), 25, 90)
    assert abs(window.measured[0, 0]) > 0.02  # m
    assert np.abs(replayed(window) - window.measured).max() < 2e-4  # 3e-3 with the second finger at its zero


def test_a_gripper_whose_fingers_keep_apart_is_clear() -> None:
    assert never_touches(GRIPPER, [_recorded()])
    closed = Episode("closed", ("left",), np.arange(2.0), np.array([[0.0], [-0.098]]), np.arange(2.0), np.zeros((2, 1)))
    assert not never_touches(GRIPPER, [closed])


@pytest.mark.usefixtures("rendering")
def test_a_picture_shows_the_finger_that_follows() -> None:
    eye = np.array([0.8, 0.0, 0.0])
    camera = Camera(48, 48, np.array([[48.0, 0, 24], [0, 48.0, 24], [0, 0, 1]]), looking_at(eye, np.zeros(3)))
    drawn = SimulationCamera(GRIPPER, camera)
    mask = drawn.mask({"left": 0.1}).astype(float)
    drawn.close()
    assert mask.sum() > 0.0
    np.testing.assert_allclose(mask, mask[:, ::-1], atol=16.0)  # as far to the left as to the right
