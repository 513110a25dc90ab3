"""Where a replay begins: the velocity at the first measurement, of motions made by MuJoCo itself at a finer step."""

import mujoco
import numpy as np
import pytest

from edream.catalog import load
from edream.core.effect import Effect
from edream.core.episode import Episode
from edream.diagnosis.remainder import ResidualTorque
from edream.sim.robot import RobotModel
from edream.sim.rollout import rollout
from edream.sim.simulation import Placement, SimulatedRobot
from edream.sim.start import recent_speed, start_velocity
from edream.sim.window import Window

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


SWING = 0.5 * np.sin(4.0 * np.pi * np.linspace(0.0, 1.0, 400))
TIMES = 0.01 * np.arange(400)


def _moved(told: np.ndarray) -> np.ndarray:
    """Where the arm goes under what its servo makes of the commands, one a row."""
    model, out = ARM.spec().compile(), []
    data = mujoco.MjData(model)
    for now in told:
        out.append(float(data.qpos[0]))
        data.ctrl[0] = now
        mujoco.mj_step(model, data, 20)
    return np.array(out)


def _replayed(effect: str, values: list[float], read: np.ndarray) -> np.ndarray:
    """A stretch from the middle of the motion with an effect, (60,)."""
    episode = Episode("one", ("a",), TIMES, read[:, None], TIMES, SWING[:, None])
    place = Placement(load("effects", effect, Effect), ("a",))
    ((replayed,),) = rollout(SimulatedRobot(ARM, (place,)), np.array([values]), [Window(episode, 90, 150)])
    return replayed[:, 0] - read[90:151]


@pytest.mark.parametrize("delay", [0.0, 0.03])
def test_a_replay_with_late_readings_begins_where_the_joint_was_and_not_where_it_was_said_to_be(delay: float) -> None:
    read = np.interp(TIMES - delay, TIMES, _moved(SWING))
    assert np.abs(_replayed("sensor_delay", [delay], read)).max() < 4e-4


@pytest.mark.parametrize(("effect", "number"), [("actuator_lag", 0.08), ("slew_limit", 1.2)])
def test_a_replay_begins_with_the_setpoint_on_its_way_to_the_command(effect: str, number: float) -> None:
    setpoint, told = SWING[0], []
    for command in SWING:
        for _ in range(20):  # the servo's own small steps
            far = command - setpoint
            setpoint += far * 5e-4 / number if effect == "actuator_lag" else np.clip(far, -number * 5e-4, number * 5e-4)
            told.append(setpoint)
    model, read = ARM.spec().compile(), []
    data = mujoco.MjData(model)
    for step, now in enumerate(told):
        if step % 20 == 0:
            read.append(float(data.qpos[0]))
        data.ctrl[0] = now
        mujoco.mj_step(model, data)
    assert np.abs(_replayed(effect, [number], np.array(read))).max() < 2e-3


@pytest.mark.parametrize("ki", [4.0, 60.0])
def test_a_replay_begins_with_what_a_servos_integral_has_gathered(ki: float) -> None:
    spec = ARM.spec()
    spec.actuators[0].set_to_pid(kp=30.0, kv=1.5, ki=ki)
    model, read = spec.compile(), []
    data = mujoco.MjData(model)
    data.qpos[0], data.ctrl[0] = 0.6, 0.6
    mujoco.mj_step(model, data, 10000)  # 5 s at rest
    told = 0.6 + SWING
    for command in told:
        read.append(data.qpos.copy())
        data.ctrl[0] = command
        mujoco.mj_step(model, data, 20)
    episode = Episode("one", ("a",), TIMES, np.array(read), TIMES, told[:, None])
    place = Placement(load("effects", "integral_action", Effect), ("a",))
    for window in (Window(episode, 0, 150), Window(episode, 130, 300)):
        ((replayed,),) = rollout(SimulatedRobot(ARM, (place,)), np.array([[ki]]), [window])
        assert np.abs(replayed - window.measured).max() < 1.5e-3
    ((forgotten,),) = rollout(SimulatedRobot(ARM, ()), np.zeros((1, 0)), [Window(episode, 130, 300)])
    assert np.abs(forgotten - Window(episode, 130, 300).measured).max() > 5e-3


def test_a_window_remembers_how_fast_the_joint_was_before_it() -> None:
    times = np.arange(0.0, 8.0, 0.01)
    command = 0.8 * np.sin(2.0 * times)[:, None]
    placed = Placement(ResidualTorque(["direction_recent_at_2"], [1.0], {}), ("a",))
    melting = SimulatedRobot(ARM, (placed,))
    free = Episode("free", ("a",), times, np.zeros_like(command), times, command)
    values = np.array([[-0.4]])
    moved = rollout(melting, values, [Window(free, 0, len(times) - 1)])[0][0]
    episode = Episode("moved", ("a",), times, moved, times, command)
    late = Window(episode, 500, len(times) - 1)
    assert recent_speed(late, 0, 2.0) > 0.5
    assert recent_speed(Window(episode, 0, 10), 0, 2.0) == 0.0
    assert np.abs(rollout(melting, values, [late])[0][0] - moved[500:]).max() < 2e-3
    cold = Episode("cold", ("a",), times[500:] - times[500], moved[500:], times[500:] - times[500], command[500:])
    assert np.abs(rollout(melting, values, [Window(cold, 0, len(cold.times) - 1)])[0][0] - moved[500:]).max() > 6e-3, "it counts"
