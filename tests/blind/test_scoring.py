"""Scoring of blind tests: what counts as right, and that finished cases are kept."""

import json
from pathlib import Path
from typing import Any

import pytest

from benchmarks.blind import runner
from benchmarks.blind.cases import PAIRS, SITES, SORTS, Case, Session, cases, drawn, robot_of
from benchmarks.blind.names import OTHER_NAME, SAME_NAME, is_usual, library_name, true_values
from benchmarks.blind.runner import finished
from benchmarks.blind.score import is_resolved, is_shown, score
from benchmarks.blind.table import markdown, table
from edream import catalog
from edream.core.errors import EdreamError
from edream.reality.effects import KINDS
from edream.reality.truth import Hidden, Truth, seal

ROBOT = robot_of("pan_tilt")
GAP = {"published_rad": 4e-3, "before_rad": 2e-3, "after_rad": 3e-4, "noise_floor_rad": 2e-4, "floor_rad": 5e-4}
DELAY = Truth("pan_tilt", (Hidden("actuator_delay", ("tilt",), {"time": 0.03}),))


def effect(name: str, target: str, confusable: tuple[str, ...] = (), value: float = 0.031) -> dict[str, Any]:
    return {
        "name": name,
        "targets": [target],
        "values": {"time": value},
        "intervals": {"time": [value - 1e-3, value + 1e-3]},
        "confusable_with": list(confusable),
    }


def scored(effects: list[dict[str, Any]], verdict: str = "named", truth: Truth = DELAY, sort: str = "single") -> dict[str, Any]:
    assert ROBOT is not None
    case = Case("pan_tilt", tuple(h.name for h in truth.effects), 0, sort)  # type: ignore[arg-type]
    return score(case, truth, ROBOT.model, {"verdict": verdict, "effects": effects, "gap": GAP, "seconds": 10.0})


def test_the_right_name_at_the_right_joint_is_right() -> None:
    row = scored([effect("actuator_delay", "tilt")])
    assert row["right"] and row["found"] == ["named"]
    assert row["closed"] == pytest.approx(1.7 / 1.8)
    assert row["values"][0]["relative"] == pytest.approx(1 / 30)


def test_a_doubt_is_resolved_by_one_right_name_and_no_other() -> None:
    right, wrong = effect("actuator_delay", "tilt"), effect("actuator_lag", "tilt")
    assert is_resolved(scored([right]))
    assert not is_resolved(scored([effect("actuator_delay", "tilt", ("actuator_lag[tilt]",))], "cannot_tell"))
    assert not is_resolved(scored([right, wrong])) and not is_resolved(scored([wrong])) and not is_resolved(scored([], "none"))
    rows = [scored([right]) | {"resolved": done, "suggested": True} for done in (True, True, False)]
    rows += [scored([right]) | {"suggested": False}]
    assert table(rows, 4)["resolved"] == [2, 3] and table(rows, 4)["suggested"] == [3, 4]
    assert "| in doubt: resolved by recording the suggested motion | 2 of 3 (67%) | >= 70 % |" in markdown(table(rows, 4), rows)


def test_a_weak_servo_that_was_strong_by_chance_stays_within_what_is_usual() -> None:
    assert ROBOT is not None
    published = float(-ROBOT.model.actuator_biasprm[1, 1])
    for strength, usual in ((1.2, True), (1.0, False)):
        truth = Truth("pan_tilt", (Hidden("servo_gain", ("tilt",), {"scale": 0.65}),), {"kp": {"tilt": strength * published}})
        assert is_usual(truth.effects[0], truth, ROBOT.model) is usual
    assert not is_usual(DELAY.effects[0], DELAY, ROBOT.model)


@pytest.mark.parametrize(
    ("effects", "verdict"),
    [
        ([effect("actuator_delay", "pan")], "named"),
        ([effect("actuator_lag", "tilt")], "named"),
        ([effect("actuator_delay", "tilt"), effect("actuator_lag", "pan")], "named"),
        ([effect("actuator_delay", "tilt")], "unnamed"),
        ([effect("actuator_lag", "tilt", ("actuator_delay[tilt]",))], "named"),
        ([effect("actuator_lag", "tilt", ("actuator_delay[pan]",))], "cannot_tell"),
        ([], "none"),
    ],
)
def test_a_wrong_joint_a_wrong_name_or_one_name_too_many_is_wrong(effects: list[dict[str, Any]], verdict: str) -> None:
    assert not scored(effects, verdict)["right"]


def test_a_confusable_name_counts_where_the_tool_says_that_it_cannot_tell() -> None:
    row = scored([effect("actuator_lag", "tilt", ("actuator_delay[tilt]",))], "cannot_tell")
    assert row["right"] and row["found"] == ["told"] and not row["values"]


def test_one_name_stands_for_one_hidden_effect() -> None:
    both = Truth("pan_tilt", (*DELAY.effects, Hidden("actuator_lag", ("tilt",), {"time": 0.03})))
    doubted = effect("actuator_delay", "tilt", ("actuator_lag[tilt]",))
    row = scored([doubted], "cannot_tell", both, "pair")
    assert row["found"] == ["named", "missed"] and not row["right"]
    beside = effect("sensor_delay", "tilt", ("actuator_delay[tilt]",))
    row = scored([effect("actuator_lag", "tilt", ("actuator_delay[tilt]",)), beside], "cannot_tell", both, "pair")
    assert row["found"] == ["told", "named"] and row["right"]


def test_a_value_outside_its_interval_and_more_than_a_tenth_off_is_wrong() -> None:
    assert not scored([effect("actuator_delay", "tilt", value=0.04)])["values"][0]["right"]


def test_any_name_is_a_false_alarm_where_nothing_is_hidden() -> None:
    nothing = Truth("pan_tilt")
    assert scored([], "none", nothing, "none")["right"]
    assert not scored([effect("actuator_delay", "tilt")], "named", nothing, "none")["right"]
    assert not scored([], "unnamed", nothing, "none")["right"]


def test_every_hidden_effect_that_the_library_should_have_has_one_name_there() -> None:
    native = {name for name, kind in KINDS.items() if not kind.foreign}
    assert native == SAME_NAME | set(OTHER_NAME)
    assert {library_name(name) for name in native} <= set(catalog.names("effects"))
    with pytest.raises(EdreamError, match="cable_snag"):
        library_name("cable_snag")


def test_nuisance_truths_add_up_to_what_the_library_calls_them() -> None:
    assert ROBOT is not None
    hidden = Hidden("viscous", ("tilt",), {"coefficient": 0.2})
    truth = Truth("pan_tilt", (hidden,), {"damping": {"tilt": 0.1}, "kd": {"tilt": 0.5}})
    assert true_values(hidden, truth, ROBOT.model) == {"damping": pytest.approx(0.8)}


def test_a_tilted_base_means_the_same_gravity_in_both_words() -> None:
    import mujoco
    import numpy as np

    assert ROBOT is not None
    hidden = Hidden("gravity_tilt", (), {"roll": 0.12, "pitch": -0.2})
    plant = Truth("pan_tilt", (hidden,)).terms(ROBOT.model)[0].plant(Truth("pan_tilt").plant(ROBOT.model))
    angle = true_values(hidden, Truth("pan_tilt", (hidden,)), ROBOT.model)
    turn = np.zeros(9)
    quaternion = np.zeros(4)
    mujoco.mju_euler2Quat(quaternion, np.array([angle["about_y"], angle["about_x"], 0.0]), "yxz")
    mujoco.mju_quat2Mat(turn, quaternion)
    np.testing.assert_allclose(turn.reshape(3, 3) @ ROBOT.model.opt.gravity, plant.gravity, atol=1e-9)


def test_all_cases_are_listed_once_and_cut_runs_see_every_robot() -> None:
    every = cases(list(SITES), list(SORTS), 3)
    foreign = sum(kind.foreign for kind in KINDS.values())
    assert len({case.code for case in every}) == len(every) == len(SITES) * (3 * (len(KINDS) + len(PAIRS)) + 5)
    assert foreign >= 5
    assert {case.robot for case in every[:3]} == set(SITES)


def test_a_longer_sample_begins_with_the_shorter_one_and_another_seed_draws_others() -> None:
    every = cases(list(SITES), list(SORTS), 3)
    few, more = drawn(every, 20, 5), drawn(every, 60, 5)
    assert more[:20] == few
    assert len(set(more)) == 60
    assert set(more) <= set(every)
    assert {case.robot for case in more} == set(SITES)
    assert drawn(every, 20, 6) != few
    with pytest.raises(EdreamError, match="--sample is 0; expected 1 or more"):
        drawn(every, 0, 5)


def test_finished_cases_are_kept_and_a_line_cut_short_is_not_one(tmp_path: Path) -> None:
    path = tmp_path / "results.jsonl"
    whole = json.dumps({"case": "a", "session": [12, 10.0, 0.0], "verdict": "none"})
    other = json.dumps({"case": "b", "session": [8, 5.0, 0.0], "verdict": "none"})
    path.write_text(f'{whole}\n{other}\n{{"case": "c", "sess')
    assert list(finished(path, Session())) == ["a"]


def test_the_table_counts_right_answers_and_shows_wrong_ones() -> None:
    rows = [scored([effect("actuator_delay", "tilt")]), scored([effect("actuator_delay", "pan")]), scored([], "none")]
    made = table(rows, 3)
    assert made["single_right"] == [1, 3]
    assert made["confusion"] == {"actuator_delay": {"actuator_delay": 1, "actuator_delay*": 1, "none": 1}}
    assert "1 of 3 (33%)" in markdown(made, rows)


def test_a_case_that_failed_counts_as_wrong_in_the_table(tmp_path: Path) -> None:
    assert ROBOT is not None
    case = Case("pan_tilt", ("actuator_delay",), 0, "single")
    (tmp_path / "truth").mkdir()
    seal(DELAY, tmp_path / "truth" / f"{case.code}.json")
    failed = runner.scored(case, ROBOT, tmp_path, Session(), {"failed": "more than 1800 s"})
    rows = [failed, scored([effect("actuator_delay", "tilt")])]
    made = table(rows, 2)
    assert made["single_right"] == made["single_visible_right"] == [1, 2]
    assert "| actuator_delay[tilt] | failed |" in markdown(made, rows)


def test_a_torque_limit_that_no_motion_reaches_changes_less_than_noise_and_is_counted_apart(tmp_path: Path) -> None:
    assert ROBOT is not None
    (tmp_path / "truth").mkdir()
    short, rows = Session(motions=2, seconds=2.0), []
    for seed, limit in enumerate((1000.0, 0.3)):
        truth = Truth("pan_tilt", (Hidden("torque_saturation", ("tilt",), {"torque": limit}),))
        case = Case("pan_tilt", ("torque_saturation",), seed, "single")
        seal(truth, tmp_path / "truth" / f"{case.code}.json")
        result = {"verdict": "none", "effects": [], "gap": GAP, "seconds": 10.0}
        rows.append(runner.scored(case, ROBOT, tmp_path, short, result))
        assert runner.scored(case, ROBOT, tmp_path, short, result) == rows[-1]
    assert [is_shown(row) for row in rows] == [False, True]
    made = table(rows, 2)
    assert made["single_right"] == [0, 2] and made["single_shown_right"] == [0, 1]
    assert "which changes less than the noise" in runner.summarise(rows[0], {}) and "WRONG" in runner.summarise(rows[0], {})
