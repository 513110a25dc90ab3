"""A servo's gain that recordings note counts wherever they are compared with a simulation."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from edream.calibration.settings import ScaledBy, SpaceSettings, scalings, simulated_robot
from edream.calibration.windows import log_factors
from edream.core.episode import Episode
from edream.core.errors import EdreamError
from edream.diagnosis.problem import Settings, prepare
from edream.sim.robot import RobotModel, load_robot
from edream.sim.simulation import SERVO_GAIN, USUAL
from edream.sim.window import whole
from edream.stages.replay import under_conditions
from tests.still_problem import commanded, pan_tilt

ROBOT = pan_tilt()


def soft(robot: RobotModel, number: int) -> Episode:
    return replace(commanded(number, robot.joints), conditions={"servo_gain": 0.5})


def test_a_noted_gain_scales_those_recordings_alone() -> None:
    recordings = [commanded(0, ROBOT.joints), soft(ROBOT, 1)]
    simulated = simulated_robot(ROBOT, SpaceSettings(("servo_gain", "coulomb")), recordings)
    assert np.exp(log_factors(simulated, whole(recordings))).ravel() == pytest.approx([1.0, 0.5])
    at = simulated.space.mapping(simulated.space.start())
    numbers = simulated.quantities(np.repeat(simulated.space.start()[None], 2, axis=0), [r.conditions for r in recordings])
    pan = at["servo_gain.kp[pan]"]
    assert numbers[0]["kp"] == pytest.approx([pan, 0.5 * pan])


def test_where_no_recording_notes_a_gain_nothing_is_scaled() -> None:
    recordings = [commanded(number, ROBOT.joints) for number in range(2)]
    simulated = simulated_robot(ROBOT, SpaceSettings(("servo_gain",)), recordings)
    assert not any(place.scaled for place in simulated.placements)
    assert log_factors(simulated, whole(recordings)).shape == (2, 0)


def test_a_config_that_scales_the_gain_by_another_condition_is_believed() -> None:
    chosen = scalings({SERVO_GAIN: ScaledBy("firmware", 400.0)}, [soft(ROBOT, 0)])
    assert chosen[SERVO_GAIN].condition == "firmware" and list(chosen) == [SERVO_GAIN]
    with pytest.raises(EdreamError, match=r"no condition 'firmware'.*servo_gain"):
        chosen[SERVO_GAIN].factor({"servo_gain": 0.5})


def test_a_noted_gain_leaves_a_motor_beside_a_position_servo_as_it_is(tmp_path: Path) -> None:
    spec = ROBOT.spec()
    spec.actuator("pan").set_to_motor()
    spec.compile()
    (tmp_path / "mixed.xml").write_text(spec.to_xml())
    scaled = under_conditions(load_robot(tmp_path / "mixed.xml"), USUAL)
    assert [place.targets for place in scaled.placements] == [("tilt",)]


def test_a_noted_gain_that_scales_nothing_fitted_is_no_secret() -> None:
    with pytest.raises(EdreamError, match=r"notes servo_gain .* fit\.effects has no servo_gain"):
        simulated_robot(ROBOT, SpaceSettings(("coulomb",)), [soft(ROBOT, 0)])
    four = [soft(ROBOT, number) for number in range(4)]
    with pytest.raises(EdreamError, match=r"notes servo_gain .* robot\.nuisance has no servo_gain"):
        prepare(ROBOT, four, Settings(nuisance=("viscous", "coulomb")))
