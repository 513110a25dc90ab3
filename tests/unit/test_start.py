"""Where a replay begins: the velocity at the first measurement, of motions made by MuJoCo itself at a finer step."""

import mujoco
import numpy as np
import pytest

from edream.core.episode import Episode
from edream.sim.robot import RobotModel
from edream.sim.rollout import Window, start_velocity

ARM = RobotModel(
    "arm",
    """<mujoco><option timestep="0.0005" integrator="implicitfast"/><worldbody><body><joint name="a" axis="0 1 0" armature="0.01"/>
    <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.03" mass="0.5"/></body></worldbody>
    <actuator><position joint="a" kp="30" kv="1.5"/></actuator></mujoco>""",
)
NOISE = 2.5e-4


def _recorded(speed: float, rate: float, jump: float, acceleration: float = 0.0) -> Episode:
    """The arm passes 0 at `speed` [rad/s]; the command runs ahead with it and jumps [rad] at the first measurement."""
    model = ARM.spec().compile()
    data, rows = mujoco.MjData(model), round(1.0 / rate / 5e-4)
    data.qvel[0] = speed
    times, rng = np.arange(0.0, 0.4, 1.0 / rate), np.random.default_rng(1)
    command = jump + speed * (times + 0.05) + 0.5 * acceleration * times**2
    position = np.empty((len(times), 1))
    for row, told in enumerate(command):
        position[row] = data.qpos
        data.ctrl[0] = told
        mujoco.mj_step(model, data, rows)
    return Episode("one", ("a",), times, position + rng.normal(0.0, NOISE, position.shape), times, command[:, None])


@pytest.mark.parametrize("rate", [50.0, 100.0])
@pytest.mark.parametrize("jump", [-0.6, 0.2, 0.6])
def test_a_joint_that_a_jump_of_the_command_sets_going_began_at_rest(rate: float, jump: float) -> None:
    assert start_velocity(Window(_recorded(0.0, rate, jump), 0, 15))[0] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("rate", [50.0, 100.0])
@pytest.mark.parametrize("speed", [-1.5, 0.8])
@pytest.mark.parametrize("acceleration", [0.0, 2.0])
def test_a_joint_that_moves_already_keeps_its_speed(rate: float, speed: float, acceleration: float) -> None:
    recorded = _recorded(speed, rate, 0.0, acceleration)
    assert start_velocity(Window(recorded, 0, 15))[0] == pytest.approx(speed, rel=0.25)
    later = 10  # rows: a window that begins inside a recording
    slope = float(np.gradient(recorded.position[:, 0], recorded.times)[later])
    assert start_velocity(Window(recorded, later, 18))[0] == pytest.approx(slope, rel=0.15)


def test_a_joint_that_rests_has_no_speed_worth_the_name() -> None:
    assert abs(start_velocity(Window(_recorded(0.0, 50.0, 0.0), 0, 15))[0]) < 3.0 * NOISE * 50.0
