"""A known weight that the hand held: noted with a recording, and simulated with it."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from edream.core.errors import EdreamError
from edream.diagnosis.next_motion import fewest
from edream.diagnosis.problem import Problem
from edream.diagnosis.set_up import HEAVY, how_to_record, other_set_ups, two_digits, weighted
from edream.record import RecordConfig
from edream.record_task import record_task
from edream.sim.mass import add_mass, hand_of
from edream.sim.robot import RobotModel
from edream.sim.rollout import rollout
from edream.sim.simulation import SimulatedRobot
from edream.sim.window import whole
from tests.still_problem import commanded, held_still, pan_tilt

ROBOT = pan_tilt()
NOTHING = np.zeros((1, 0))


def carrying(robot: RobotModel, weight: float) -> RobotModel:
    """The robot with a small, heavy ball fixed to its hand, as MuJoCo has it."""
    _, point = hand_of(robot)
    inertial = f'<inertial pos="0 0 0" mass="{weight}" diaginertia="1e-9 1e-9 1e-9"/>'
    ball = f'<body name="ball" pos="{" ".join(map(str, point))}">{inertial}</body>'
    return replace(robot, mjcf=robot.mjcf.replace('<site name="ee"', f'{ball}\n<site name="ee"'))


def test_a_recording_with_a_weight_moves_as_a_robot_that_carries_it_and_the_others_as_before() -> None:
    empty = commanded(0, ROBOT.joints)
    loaded = replace(commanded(1, ROBOT.joints), conditions={"hand_weight": 0.3})
    bare, laden = SimulatedRobot(ROBOT, ()), SimulatedRobot(carrying(ROBOT, 0.3), ())
    for simulated in (bare, bare.swift):
        moved = rollout(simulated, NOTHING, whole([empty, loaded]))
        alone = rollout(bare, NOTHING, whole([empty, replace(loaded, conditions={})]))
        true = rollout(laden, NOTHING, whole([replace(loaded, conditions={})]))
        np.testing.assert_allclose(moved[0], alone[0], atol=1e-6)
        np.testing.assert_allclose(moved[1], true[0], atol=1e-6)
        assert np.abs(moved[1] - alone[1]).max() > 0.01


def test_masses_on_one_body_add_up() -> None:
    class Few(dict[str, Any]):
        model = ROBOT.model

        def __missing__(self, name: str) -> np.ndarray:
            self[name] = np.repeat(getattr(ROBOT.model, name)[None], 2, axis=0).copy()
            return self[name]

    head, (one, other) = ROBOT.model.body("head").id, ([0.15, 0.0, 0.015], [0.0, 0.1, -0.05])
    step, once = Few(), Few()
    add_mass(step, head, np.array([0.2, 0.0]), np.array([one, one]))
    add_mass(step, head, np.array([0.1, 0.0]), np.array([other, other]))
    both = (0.2 * np.array(one) + 0.1 * np.array(other)) / 0.3
    add_mass(once, head, np.array([0.3, 0.0]), np.array([both, both]))
    for name in ("body_mass", "body_ipos"):
        np.testing.assert_allclose(step[name], once[name])
        np.testing.assert_array_equal(step[name][1], getattr(ROBOT.model, name))  # nothing held
    apart = sum(m * np.sum((np.array(p) - both) ** 2) for m, p in ((0.2, one), (0.1, other)))
    assert step["body_inertia"][0].sum() == pytest.approx(once["body_inertia"][0].sum() + 2.0 * apart)


def test_a_robot_that_holds_a_weight_sags_by_it_and_its_recordings_say_so(tmp_path: Path) -> None:
    rest = {}
    for weight in (0.0, 0.2):
        first = held_still(ROBOT, tmp_path, f"with-{weight}", weight=weight)
        assert dict(first.conditions) == ({} if weight == 0.0 else {"hand_weight": 0.2})
        rest[weight] = float(np.mean(first.position[-20:, ROBOT.joint_index("tilt")]))
    ((_, point), gain) = hand_of(ROBOT), 20.0
    assert rest[0.2] - rest[0.0] == pytest.approx(-0.2 * 9.81 * point[0] / gain, rel=0.1)


def test_the_hand_is_where_the_end_effector_is() -> None:
    body, point = hand_of(ROBOT)
    assert ROBOT.model.body(body).name == "head" and point == pytest.approx([0.15, 0.0, 0.015])
    again, there = hand_of(replace(ROBOT, site=None))
    assert again == body and there == pytest.approx(point)


def test_a_weight_in_a_hand_without_a_name_is_one_sentence() -> None:
    nameless = replace(
        ROBOT, mjcf=ROBOT.mjcf.replace('<site name="ee"', '<body pos="0.1 0 0"><geom size="0.01"/></body>\n<site name="ee"')
    )
    loaded = replace(commanded(1, ROBOT.joints), conditions={"hand_weight": 0.3})
    with pytest.raises(EdreamError, match=r"hand_weight in conditions\.csv.*no name"):
        rollout(SimulatedRobot(replace(nameless, site=None), ()), NOTHING, whole([loaded]))


def test_a_weight_below_nothing_is_one_sentence() -> None:
    floating = replace(commanded(1, ROBOT.joints), conditions={"hand_weight": -0.3})
    with pytest.raises(EdreamError, match=r"hand_weight = -0\.3 in conditions\.csv; expected 0 kg or more"):
        rollout(SimulatedRobot(ROBOT, ()), NOTHING, whole([floating]))


def test_the_weight_asked_for_pulls_less_than_the_robot_and_its_servos_bear_it(problem: Problem) -> None:
    (weight,) = weighted(problem).values()
    poses = np.concatenate([window.episode.position for window in problem.fitted])

    def pull(robot: RobotModel) -> float:
        data = mujoco.MjData(robot.model)
        most = 0.0
        for pose in poses[::4]:
            data.qpos[:] = pose
            mujoco.mj_forward(robot.model, data)
            most = max(most, abs(float(data.qfrc_bias[1])))
        return most

    own = pull(problem.robot)
    assert 1.4 * own < pull(carrying(problem.robot, weight)) < (1.02 + HEAVY) * own
    weak = replace(problem.robot, mjcf=problem.robot.mjcf.replace("-5 5", f"{-1.5 * own} {1.5 * own}"))
    (bearable,) = weighted(replace(problem, robot=weak)).values()
    assert 0.0 < bearable < weight and pull(carrying(weak, bearable)) <= 0.82 * 1.5 * own
    weaker = replace(problem.robot, mjcf=problem.robot.mjcf.replace("-5 5", f"{-own} {own}"))
    assert weighted(replace(problem, robot=weaker)) == {}


def test_set_ups_are_those_that_the_robot_has(problem: Problem) -> None:
    softer, heavier, both = other_set_ups(problem)
    assert softer == {"servo_gain": 0.5} and both == softer | heavier
    upright = replace(problem.robot, mjcf=problem.robot.mjcf.replace('axis="0 -1 0"', 'axis="0 0 1"'))
    assert other_set_ups(replace(problem, robot=upright)) == [{"servo_gain": 0.5}]
    held = [replace(w, episode=replace(w.episode, conditions={"hand_weight": 0.1})) for w in problem.fitted]
    assert other_set_ups(replace(problem, fitted=held)) == [{"servo_gain": 0.5}]


def test_no_weight_is_asked_for_in_a_hand_without_a_name(problem: Problem) -> None:
    tool = '<body pos="0.1 0 0"><geom size="0.01"/></body>\n<site name="ee"'
    nameless = replace(problem.robot, mjcf=problem.robot.mjcf.replace('<site name="ee"', tool), site=None)
    assert other_set_ups(replace(problem, robot=nameless)) == [{"servo_gain": 0.5}]


def test_weights_are_said_with_two_digits() -> None:
    assert [two_digits(w) for w in (0.2389, 3.0, 0.0051, 12.7, 0.0, -1.0)] == [0.23, 3.0, 0.0051, 12.0, 0.0, 0.0]


@pytest.mark.parametrize(
    ("apart", "chosen"),
    [
        ([[9, 9], [9, 9]], (0,)),
        ([[9, 0], [0, 0], [9, 9]], (2,)),
        ([[9, 0, 0], [0, 9, 0], [0, 9, 9]], (0, 2)),
        ([[0.9, 0], [9, 0.9]], (1,)),
        ([[1.2, 9], [7, 9], [0, 0]], (1,)),  # the first is hardly enough for both
        ([[1.2, 0], [1.3, 0]], (0,)),  # no other is much better
    ],
)
def test_the_fewest_set_ups_that_tell_as_much_are_asked_for(apart: list[list[float]], chosen: tuple[int, ...]) -> None:
    assert fewest(np.array(apart), 1.0, 5.0) == chosen


def test_how_to_record_says_each_way_and_what_to_note() -> None:
    assert how_to_record([{}]) == "Record the suggested motion a few times."
    said = how_to_record([{}, {"servo_gain": 0.5, "hand_weight": 0.2}])
    assert said == (
        "Record the suggested motion a few times as the robot is, and a few times with 0.5 times the servos' usual position gain "
        "and with a weight of 0.2 kg in the hand (or another that you note); note hand_weight = 0.2 and servo_gain = 0.5 of these "
        "in conditions.csv."
    )


def test_a_task_is_demonstrated_with_an_empty_hand(tmp_path: Path) -> None:
    with pytest.raises(EdreamError, match=r"record\.weight is 0\.2"):
        record_task(ROBOT, "grab_paper_cup", RecordConfig(tmp_path / "out", weight=0.2))
