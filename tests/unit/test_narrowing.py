"""An effect that stands on a group of joints keeps those that it is on."""

from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.blind.cases import robot_of
from edream.diagnosis import narrowing
from edream.diagnosis.candidates import Candidate
from edream.diagnosis.left_out import left_out_errors
from edream.diagnosis.narrowing import narrowed
from edream.diagnosis.nuisance import fit_nuisance
from edream.diagnosis.problem import Settings, prepare
from edream.diagnosis.screen import Scored
from edream.diagnosis.trials import refit
from edream.reality.truth import draw
from edream.sim.robot import RobotModel
from tests.stand_in import episodes_of


def _robot(differently: bool) -> RobotModel:
    robot = robot_of("pan_tilt")
    assert robot is not None
    if not differently:
        return robot
    spec = robot.spec()
    spec.actuator("pan").forcerange = [-6.0, 6.0]
    spec.compile()
    return RobotModel(robot.name, spec.to_xml(), robot.assets, robot.site)


@pytest.mark.parametrize(
    ("on", "differently", "kept"),
    [
        (("tilt",), False, ("tilt",)),
        pytest.param(("pan", "tilt"), True, None, marks=pytest.mark.slow),
    ],  # of one hardware, but the motions of the pan joint speak against it
)
def test_a_group_keeps_the_joints_that_an_effect_is_on(
    on: tuple[str, ...], differently: bool, kept: tuple[str, ...] | None
) -> None:
    robot = _robot(differently)
    truth = draw(robot, ["actuator_delay"] * len(on), np.random.default_rng(5), 0.3, on)
    episodes = episodes_of(robot, truth, 5, 4, 5.0)
    problem = prepare(robot, episodes, Settings())
    fit = fit_nuisance(problem)
    errors = left_out_errors(problem, fit)
    taken = refit(problem, fit, errors, Scored(Candidate("actuator_delay", ("pan", "tilt")), {"time": 0.02}, 0.5))
    found = narrowed(problem, fit, errors, taken, taken.fit)
    assert (found and found[0].candidate.targets) == kept
    if found:
        value = found[1].space.mapping(found[1].values)["actuator_delay.time[tilt]"]
        assert value == pytest.approx(truth.effects[0].values["time"], abs=0.001)


@pytest.mark.parametrize(
    ("value", "interval", "stays_alike", "stays_apart"),
    [
        (0.019, (0.017, 0.021), True, True),  # it has the effect
        (0.001, (0.0, 0.003), False, False),  # it has not
        (0.004, (0.0, 0.2), True, False),  # nobody knows: as its like
        (0.004, (0.003, 0.005), False, False),  # something, but not this
    ],
)
def test_what_keeps_a_joint_in_a_group(value: float, interval: tuple[float, float], stays_alike: bool, stays_apart: bool) -> None:
    problem, name = SimpleNamespace(robot=_robot(False), settings=Settings(), scaled={}, creep=None), "actuator_delay.time[pan]"
    space = SimpleNamespace(mapping=lambda values: {name: value})
    own = SimpleNamespace(space=space, values=None, intervals=lambda: {name: interval})
    for same, stays in ((True, stays_alike), (False, stays_apart)):
        assert narrowing._stays(problem, Candidate("actuator_delay", ("pan",)), own, {"time": 0.02}, same) is stays
