"""Whether a diagnosed simulator has the robot elsewhere, so that a camera would see it."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.blind.cases import robot_of
from edream import catalog
from edream.core.effect import Effect
from edream.sim.emit import emit
from edream.sim.robot import RobotModel
from edream.sim.simulation import Placement, SimulatedRobot
from edream.sim.standing import stand_alike

READINGS = np.random.default_rng(3).uniform(0.0, 0.07, (5, 7))


def emitted(robot: RobotModel, effect: str, target: str, values: Mapping[str, float]) -> RobotModel:
    placed = SimulatedRobot(robot, (Placement(catalog.load("effects", effect, Effect), (target,)),))
    return replace(robot, mjcf=emit(placed, {f"{effect}.{name}[{target}]": value for name, value in values.items()}).mjcf)


@pytest.mark.parametrize(
    ("effect", "target", "values", "alike"),
    [
        ("payload", "hand", {"mass": 1.0, "x": 0.03, "y": 0.0, "z": -0.03}, True),
        ("actuator_lag", "joint2", {"time": 0.07}, True),
        ("spring", "joint3", {"stiffness": 4.0, "reference": 0.5}, True),
        ("encoder_offset", "joint2", {"angle": 0.002}, False),
        ("gear_ratio", "joint3", {"ratio": 1.0, "encoder": 1.1}, False),
    ],
)
def test_what_pulls_and_what_is_late_moves_no_link_and_an_encoder_does(
    effect: str, target: str, values: Mapping[str, float], alike: bool
) -> None:
    robot = robot_of("arm6")
    assert robot is not None
    assert stand_alike(robot, emitted(robot, effect, target, values), READINGS) == alike
