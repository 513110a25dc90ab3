"""What hooks add to a servo's torque stays within the limit of what the servo gives."""

import importlib.util
from pathlib import Path
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from edream.catalog import load
from edream.core.effect import Effect
from edream.core.episode import Episode
from edream.sim.emit import emit
from edream.sim.limits import let_through, limits_of
from edream.sim.robot import load_robot
from edream.sim.rollout import rollout
from edream.sim.simulation import Placement, SimulatedRobot
from edream.sim.window import whole

GAIN, DAMPING, LIMIT, INERTIA, WIDTH = 900.0, 4.0, 3.0, 0.05, 0.008  # the band holds more than the motor gives
STIFF = f"""<mujoco><option timestep="0.0005"/><worldbody><body><joint name="a" axis="0 0 1" armature="{INERTIA}"/>
  <geom type="sphere" size="0.001" mass="1e-6"/></body></worldbody><actuator>
  <position name="a" joint="a" kp="{GAIN}" kv="{DAMPING}" forcerange="-{LIMIT} {LIMIT}"/></actuator></mujoco>"""


def by_hand(times: np.ndarray, command: np.ndarray, step: float) -> np.ndarray:
    """A servo with a dead zone and a limit, integrated in small steps."""
    q, speed, out = 0.0, 0.0, []
    for wanted in command:
        out.append(q)
        for _ in range(round((times[1] - times[0]) / step)):
            error = wanted - q
            asked = GAIN * (error - np.clip(error, -WIDTH, WIDTH)) - DAMPING * speed
            speed += step * np.clip(asked, -LIMIT, LIMIT) / INERTIA
            q += step * speed
    return np.array(out)


def test_a_servo_with_a_dead_zone_gives_all_it_has_far_from_its_command(tmp_path: Path) -> None:
    """What the band takes back had been taken from the torque that the limit leaves: the joint ran away from its command."""
    (tmp_path / "stiff.xml").write_text(STIFF)
    robot = load_robot(tmp_path / "stiff.xml")
    times = 0.02 * np.arange(100)
    command = 0.3 * np.sin(4.0 * times)
    episode = Episode("moves", robot.joints, times, np.zeros((100, 1)), times, command[:, None])
    simulated = SimulatedRobot(robot, (Placement(load("effects", "dead_zone", Effect), ("a",)),))
    expected = by_hand(times, command, 5e-5)
    ours = rollout(simulated, np.array([[WIDTH]]), whole([episode]), threads=1)[0][0][:, 0]
    assert np.abs(ours - expected).max() < 0.002
    made = emit(simulated, {"dead_zone.width[a]": WIDTH})
    (tmp_path / "hook.py").write_text(made.hook or "")
    spec = importlib.util.spec_from_file_location("limited_hook", tmp_path / "hook.py")
    assert spec is not None and spec.loader is not None
    hook = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(hook)
    model = mujoco.MjModel.from_xml_string(made.mjcf)
    data, step = mujoco.MjData(model), hook.make(model)
    for k in range(round(times[-1] / model.opt.timestep)):
        data.ctrl[:] = command[np.searchsorted(times, k * model.opt.timestep + 1e-9, side="right") - 1]
        step(model, data)
        mujoco.mj_step(model, data)
    assert data.qpos[0] == pytest.approx(ours[-1], abs=1e-6)


@pytest.mark.parametrize(
    ("error", "more", "expected"), [(0.001, -0.5, -0.5), (0.1, -30.0, 0.0), (0.1, -89.0, -2.0), (0.1, 5.0, 0.0)]
)
def test_more_torque_than_the_law_asks_for_meets_the_limit(error: float, more: float, expected: float) -> None:
    state = SimpleNamespace(ctrl=np.array([[error]]), qpos=np.zeros((1, 1)), qvel=np.zeros((1, 1)))
    state.gain, state.speed_gain, state.limits = np.array([[900.0]]), np.array([[4.0]]), np.array([[[-3.0, 3.0]]])
    index = {"actuator": 0, "ctrl": 0, "drive": 0, "drive_qpos": 0}
    assert let_through(state, index, np.array([more]))[0] == pytest.approx(expected)


def test_a_joints_own_limit_counts_beside_its_servos() -> None:
    text = STIFF.replace('armature="0.05"', 'armature="0.05" actuatorfrcrange="-1 2"')
    model = mujoco.MjModel.from_xml_string(text)
    np.testing.assert_array_equal(limits_of(model, model.actuator_forcerange[None])[0], [[-1.0, 2.0]])
    free = mujoco.MjModel.from_xml_string(STIFF.replace(' forcerange="-3.0 3.0"', ""))
    np.testing.assert_array_equal(limits_of(free, free.actuator_forcerange[None])[0], [[-np.inf, np.inf]])
