"""The outsider's recordings: each thing that can be hidden moves the robot otherwise, and nothing else does."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from benchmarks import plain_mujoco
from edream import config

ARM = config.conf_folder().parent / "edream" / "robots" / "arm6.xml"
HIDDEN = {
    "load": "0.2",
    "stribeck": "2:0.15",
    "spring": "8:0.3",
    "drag": "30",
    "cogging": "1:9",
    "wind": "2:0.7",
    "payload": "0.5",
    "limit": "2",
    "tilt": "0.1",
    "delay": "0.03",
    "slew": "0.2",
    "lag": "0.05",
}


def played(told: str | None) -> np.ndarray:
    """One motion of two seconds, (T, J), as the script plays it."""
    model = mujoco.MjModel.from_xml_path(str(ARM))
    push, way = plain_mujoco.hidden(model, told) if told else (lambda data: None, lambda u: u)
    model.opt.timestep = plain_mujoco.STEP
    mujoco.mj_setConst(model, mujoco.MjData(model))
    joints = [model.joint(model.actuator_trnid[a, 0]) for a in range(model.nu)]
    places = [int(one.qposadr[0]) for one in joints]
    _, u = plain_mujoco.commands(np.random.default_rng(3), *plain_mujoco.room(model, joints, places))
    return plain_mujoco.played(model, places, u[:100], np.random.default_rng(0), push, way)


@pytest.fixture(scope="module")
def plain() -> np.ndarray:
    return played(None)


def test_every_kind_is_tried() -> None:
    assert set(HIDDEN) == {*plain_mujoco.EFFECTS, *plain_mujoco.CHANGES, *plain_mujoco.WAYS}


@pytest.mark.parametrize("kind", HIDDEN)
def test_what_is_hidden_moves_its_joint(kind: str, plain: np.ndarray) -> None:
    difference = np.sqrt(np.mean((played(f"{kind}:joint2:{HIDDEN[kind]}") - plain) ** 2, axis=0))
    assert difference[1] > 5e-4  # rad, on joint2; noise is drawn alike
    assert kind not in plain_mujoco.WAYS or difference.argmax() == 1


def test_a_delay_is_as_long_as_it_says() -> None:
    steps = np.arange(100.0)
    late = plain_mujoco.WAYS["delay"](0.01)(steps)
    assert len(late) == 100 and np.array_equal(late[20:], steps[:80]) and not late[:20].any()
    assert not plain_mujoco.WAYS["delay"](1.0)(steps).any(), "longer than the motion"


@pytest.mark.parametrize("told", ["limit:wheel:1", "lag:wheel:0.1"])
def test_a_joint_that_no_servo_drives_has_no_limit_and_no_commands(told: str) -> None:
    body = "<body><joint name='wheel'/><geom size='.1'/></body>"
    with pytest.raises(ValueError, match=r"no servo drives wheel"):
        plain_mujoco.hidden(mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{body}</worldbody></mujoco>"), told)


@pytest.mark.parametrize("told", ["spring", "sprung:joint2:1:2", "spring:knee:1:2", "spring:joint2:1", "limit:joint2:1:2"])
def test_what_cannot_be_hidden_is_said(told: str) -> None:
    with pytest.raises(ValueError, match=r"expected EFFECT|numbers"):
        plain_mujoco.hidden(mujoco.MjModel.from_xml_path(str(ARM)), told)


def test_a_motion_is_a_table_that_edream_reads(tmp_path: Path) -> None:
    plain_mujoco.write_motion(tmp_path, 3, ("a", "b"), np.arange(10.0).reshape(2, 5))
    lines = (tmp_path / "motion_03.csv").read_text().splitlines()
    assert lines[0] == "time,command_a,command_b,position_a,position_b" and len(lines) == 3
