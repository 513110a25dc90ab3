"""Where a servo's encoder sits decides what a gear that gives costs."""

import re
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from edream import catalog
from edream.core.effect import Effect
from edream.core.episode import Episode
from edream.sim.robot import RobotModel, load_robot
from edream.sim.rollout import rollout
from edream.sim.simulation import Placement, SimulatedRobot
from edream.sim.window import whole

HELD = 0.6  # rad, where gravity pulls at the head


@cache
def head() -> RobotModel:
    return load_robot(Path(__file__).resolve().parents[2] / "edream" / "robots" / "pan_tilt.xml", site="ee")


def settled(effect: str, **quantities: float) -> float:
    """Where the tilt joint comes to rest [rad] when told to hold still at `HELD`, without friction of its servo."""
    return float(held(effect, HELD, **quantities)[-1])


def held(effect: str, begin: float, **quantities: float) -> np.ndarray:
    """The tilt joint [rad], (T,), from rest at `begin`, told to hold still at `HELD`, without friction of its servo."""
    robot = head()
    times = np.arange(0.0, 3.0, 0.02)
    command = np.tile([0.0, HELD], (len(times), 1))
    episode = Episode("hold", robot.joints, times, np.tile([0.0, begin], (len(times), 1)), times, command)
    placements = [
        Placement(catalog.load("effects", "coulomb", Effect), ("tilt",)),
        Placement(catalog.load("effects", effect, Effect), ("tilt",)),
    ]
    simulated = SimulatedRobot(robot, tuple(placements))
    given = {"coulomb.torque[tilt]": 0.0} | {f"{effect}.{name}[tilt]": value for name, value in quantities.items()}
    values = np.array([[given[p.name] for p in simulated.space.parameters]])
    return rollout(simulated, values, whole([episode]))[0][0, :, 1]


def test_a_shaft_that_gives_costs_its_twist_where_the_servo_follows_its_motor_and_nothing_more_where_it_follows_the_link() -> None:
    rigid, motor, link = (settled("compliance", give=g, feedback=f, bearing=0.0) for g, f in ((0.0, 0.0), (0.02, 0.0), (0.02, 1.0)))
    kp = float(-head().model.actuator_biasprm[1, 1])
    sag = HELD - rigid  # gravity's torque over kp
    assert abs(sag) > 2e-3
    assert HELD - motor == pytest.approx(sag * (1.0 + 0.02 * kp), rel=0.02)
    assert HELD - link == pytest.approx(sag, rel=0.02)


def test_a_loaded_gear_with_play_rests_half_a_gap_away_from_its_motor_and_a_servo_on_the_link_makes_up_for_it() -> None:
    rigid, motor, link = (settled("backlash", play=p, feedback=f, bearing=0.0) for p, f in ((0.0, 0.0), (0.02, 0.0), (0.02, 1.0)))
    assert abs(rigid - motor) == pytest.approx(0.02, rel=0.05)
    assert link == pytest.approx(rigid, abs=1e-3)


def test_friction_behind_a_gear_holds_the_link_within_the_play() -> None:
    free, stuck = (settled("backlash", play=0.02, feedback=0.0, bearing=torque) for torque in (0.0, 5.0))
    assert abs(stuck - HELD) < 1e-3 < abs(free - HELD)


@pytest.mark.parametrize(("effect", "quantities"), [("compliance", {"give": 0.02}), ("backlash", {"play": 0.02})])
@pytest.mark.parametrize("feedback", [0.0, 1.0])
def test_a_replay_that_begins_at_rest_begins_with_its_gears_under_load(
    effect: str, quantities: dict[str, float], feedback: float
) -> None:
    everything = {**quantities, "feedback": feedback, "bearing": 0.0}
    rest = settled(effect, **everything)
    assert abs(rest - HELD) > 5e-3
    assert np.abs(held(effect, rest, **everything) - rest).max() < 2e-4


@pytest.mark.parametrize("effect", ["backlash", "compliance"])
def test_a_servo_that_takes_its_range_from_its_joint_keeps_it_behind_a_gear(tmp_path: Path, effect: str) -> None:
    """`inheritrange`, as many published models have it: MuJoCo cannot compile it on a rotor, which has no range."""
    text = head().mjcf
    inherited = re.sub(r'ctrlrange="[^"]*"', 'inheritrange="0.9"', text)
    assert inherited.count("inheritrange") == 2
    path = tmp_path / "inherits.xml"
    path.write_text(inherited)
    robot = load_robot(path, site="ee")
    placements = [Placement(catalog.load("effects", effect, Effect), (joint,)) for joint in robot.joints]
    model = SimulatedRobot(robot, tuple(placements)).model
    assert np.allclose(model.actuator_ctrlrange, robot.model.actuator_ctrlrange)
    assert robot.model.actuator_ctrllimited.all() and model.actuator_ctrllimited.all()
