"""Where torque was off, a real servo's gain explains nothing: measured falls of an XL330 pendulum."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from edream.calibration.settings import RobotSettings, ScaledBy, SpaceSettings, simulated_robot
from edream.core.episode import Episode
from edream.ingest.recordings import ingest_recordings
from edream.sim.objective import Objective, rms
from edream.sim.simulation import SimulatedRobot
from edream.sim.window import Window, whole

EFFECTS = ("servo_gain", "viscous", "derivative_gain", "coulomb", "armature")


@pytest.fixture(scope="module")
def falls(shared_data: Path) -> list[Episode]:
    """The recordings in which torque is switched off while the weight is up."""
    found = ingest_recordings(shared_data / "xl330" / "recordings", ("pendulum",))
    return [one[0] for one in found if isinstance(one, tuple) and "lift_and_drop" in one[0].name]


@pytest.fixture(scope="module")
def pendulum(shared_data: Path) -> SimulatedRobot:
    robot = RobotSettings(shared_data / "xl330" / "pendulum.xml").load()
    return simulated_robot(robot, SpaceSettings(EFFECTS, scaled={"servo_gain.kp": ScaledBy("firmware_kp", 400.0)}))


def after_the_switch(episode: Episode) -> Window:
    assert episode.enabled is not None and episode.enabled[0] and not episode.enabled[-1]
    off = episode.command_times[np.argmin(episode.enabled)]
    return Window(episode, int(np.searchsorted(episode.times, off)) + 1, len(episode.times) - 1)


def test_while_torque_is_off_neither_gain_of_the_servo_moves_anything(falls: list[Episode], pendulum: SimulatedRobot) -> None:
    assert len(falls) == 3
    objective = Objective(pendulum, [after_the_switch(episode) for episode in falls])
    start = pendulum.space.start()
    base = objective.residuals(start)[0]
    for name, value in zip(pendulum.space.names, start, strict=True):
        other = np.where(np.array(pendulum.space.names) == name, 3.0 * value, start)
        moved = np.abs(objective.residuals(other)[0] - base).max()
        assert (moved == 0.0) == (name.startswith(("servo_gain", "derivative_gain"))), name


def test_a_replay_that_knows_of_the_switch_falls_as_the_real_arm_did(falls: list[Episode], pendulum: SimulatedRobot) -> None:
    start = pendulum.space.start()
    for episode in falls:
        told = Objective(pendulum, whole([episode]))
        untold = Objective(pendulum, whole([replace(episode, enabled=None)]))
        switch = after_the_switch(episode).first
        errors = [rms(one.residuals(start)[0][switch:]) for one in (told, untold)]
        assert errors[0] < 0.6 * errors[1], episode.name
