"""A parameter that moves nothing is told, unless its effect does move something and it only shapes that."""

import numpy as np
import pytest

from benchmarks.blind.cases import robot_of
from edream import catalog
from edream.calibration.moves import check_moves
from edream.calibration.settings import SpaceSettings, simulated_robot
from edream.core.effect import Effect
from edream.core.episode import Episode
from edream.core.errors import EdreamError
from edream.sim.objective import Objective
from edream.sim.simulation import Placement, SimulatedRobot
from edream.sim.window import whole


def objective(effects: dict[str, dict[str, float]]) -> Objective:
    """Pan and tilt moving gently, with effects on pan, some of whose quantities are held."""
    robot = robot_of("pan_tilt")
    assert robot is not None
    times = np.arange(0.0, 3.0, 0.02)
    command = 0.3 * np.sin(times[:, None] * [1.0, 1.4])
    windows = whole([Episode("gentle", robot.joints, times, command, times, command)])
    placed = tuple(Placement(catalog.load("effects", name, Effect), ("pan",), fixed=held) for name, held in effects.items())
    return Objective(SimulatedRobot(robot, placed), windows)


def test_a_share_within_a_limit_that_is_not_reached_at_first_is_no_mistake() -> None:
    check_moves(objective({"coulomb": {}, "torque_limit": {}}))


def test_a_parameter_whose_effect_moves_nothing_is_named() -> None:
    with pytest.raises(EdreamError, match=r"torque_limit\.inside\[pan\]' moves nothing"):
        check_moves(objective({"coulomb": {}, "torque_limit": {"torque": 900.0}}))


def test_an_effect_without_a_place_acts_on_joints_that_count_and_with_one_wherever_it_says() -> None:
    robot = robot_of("pan_tilt")
    assert robot is not None
    everywhere = simulated_robot(robot, SpaceSettings(("coulomb",), joints=("pan",)))
    assert everywhere.space.names == ("coulomb.torque[pan]",)
    named = simulated_robot(robot, SpaceSettings(("coulomb", "viscous@tilt"), joints=("pan",)))
    assert named.space.names == ("coulomb.torque[pan]", "viscous.damping[tilt]")
    with pytest.raises(EdreamError, match="pann"):
        simulated_robot(robot, SpaceSettings(("coulomb",), joints=("pann",)))
