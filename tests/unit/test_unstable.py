"""A simulation that blows up is an answer: nothing is printed, no log file is left behind, and MuJoCo is as it was."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from edream.core.episode import Episode
from edream.sim.robot import RobotModel
from edream.sim.rollout import rollout
from edream.sim.simulation import SimulatedRobot
from edream.sim.window import whole

STIFF = (
    "<mujoco><option timestep='0.05'/><worldbody><body><joint name='j' axis='0 1 0'/><geom size='.1' pos='0 0 .2' mass='.01'/>"
    "</body></worldbody><actuator><position joint='j' kp='1e6' kv='1e5'/></actuator></mujoco>"
)


def test_an_unstable_replay_is_nan_and_says_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    times = np.arange(0.0, 2.0, 0.05)
    moving = 0.3 * np.sin(5.0 * times)[:, None]
    episode = Episode("shaking", ("j",), times, moving, times, moving[::-1].copy())
    before = mujoco.get_mju_user_warning()
    found = rollout(SimulatedRobot(RobotModel("stiff", STIFF), ()), np.zeros((3, 0)), whole([episode]), threads=2)[0]
    assert np.isnan(found[:, 1:]).all()
    assert capfd.readouterr() == ("", "")
    assert not list(tmp_path.iterdir())
    assert mujoco.get_mju_user_warning() == before
