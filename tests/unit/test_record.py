"""Recording the make-believe robot along commands that somebody wrote."""

from pathlib import Path

import numpy as np
import pytest

from edream.catalog import load
from edream.config import compose
from edream.core.errors import EdreamError
from edream.core.format import Format, ReadOptions
from edream.record import RecordConfig, read_motion, record
from edream.sim.robot import RobotModel, load_robot
from tests.still_problem import held_still

TABLE = "time,tilt,pan\n5.0,0.0,0.0\n6.0,0.2,0.1\n7.0,-0.2,0.5\n"


@pytest.fixture(scope="module")
def robot() -> RobotModel:
    return load_robot(Path(str(compose(["robot=pan_tilt"]).robot.mjcf)), "pan_tilt", "ee")


def test_commands_of_a_table_are_played_joint_by_joint_by_name(robot: RobotModel, tmp_path: Path) -> None:
    (tmp_path / "next.csv").write_text(TABLE)
    config = RecordConfig(tmp_path / "data", motions=2, motion=tmp_path / "next.csv", rate=50.0)
    made = record(robot, config, seed=3)
    assert made["recordings"] == 2
    first = next(iter(load("formats", "aloha_hdf5", Format).recordings(tmp_path / "data", ReadOptions())))
    command = dict(zip(robot.joints, np.asarray(first.command).T, strict=True))
    assert (
        command["pan"][0] == pytest.approx(0.0)
        and command["pan"][50] == pytest.approx(0.1)
        and command["pan"][-1] == pytest.approx(0.5)
    )
    assert command["tilt"][50] == pytest.approx(0.2) and command["tilt"][-1] == pytest.approx(-0.2)


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("time,pan\n0,0\n1,1\n", "no column 'tilt'"),
        ("time,pan,tilt\n0,0,0\n", "at least 2 rows"),
        ("time,pan,tilt\n0,0,0\n1,x,0\n", "finite numbers"),
        ("time,pan,tilt\n1,0,0\n0,0,0\n", "rising times"),
        ("time,pan,tilt\n0,0\n1,1,1,1\n", "not a table of numbers"),
    ],
)
def test_a_table_that_cannot_be_played_is_one_sentence(robot: RobotModel, tmp_path: Path, text: str, part: str) -> None:
    (tmp_path / "bad.csv").write_text(text)
    with pytest.raises(EdreamError, match=part):
        read_motion(tmp_path / "bad.csv", robot, 50.0)


def test_a_motion_file_that_is_not_there_is_one_sentence(robot: RobotModel, tmp_path: Path) -> None:
    with pytest.raises(EdreamError, match=r"There is no file"):
        read_motion(tmp_path / "none.csv", robot, 50.0)


def test_servos_at_half_their_gain_sag_twice_as_far_and_the_recordings_say_so(robot: RobotModel, tmp_path: Path) -> None:
    sag = {}
    for gain in (1.0, 0.5):
        first = held_still(robot, tmp_path, f"at-{gain}", gain=gain)
        assert dict(first.conditions) == ({} if gain == 1.0 else {"servo_gain": 0.5})
        sag[gain] = float(np.mean(first.position[-20:, robot.joint_index("tilt")]))
    assert abs(sag[1.0]) > 0.01
    assert sag[0.5] == pytest.approx(2.0 * sag[1.0], rel=0.1)
