"""A joint that holds things is fitted where it holds nothing."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from edream import config, pipeline
from edream.calibration.gripping import free_stretches, gripping, with_numbers
from edream.calibration.settings import RobotSettings, SpaceSettings, scored, simulated_robot
from edream.core.episode import Episode
from edream.core.errors import EdreamError
from edream.practice.rehearsing import RolloutOptions, drawn_physics
from edream.record import RecordConfig, record
from edream.sim.robot import RobotModel

MODEL = """<mujoco><option integrator="implicitfast"/><worldbody>
  <body name="arm"><joint name="turn" axis="0 0 1" damping="1"/><geom type="capsule" size=".02" fromto="0 0 0 .3 0 0" mass="1"/>
    <body name="finger" pos=".3 0 0">
      <joint name="gap" type="slide" axis="0 1 0" range="0 .07" armature=".6" damping="{damping}" frictionloss="{friction}"
        solreffriction=".004" solimpfriction=".999 .999"/>
      <geom type="box" size=".02 .005 .01" mass=".05" contype="0" conaffinity="0"/>
    </body></body></worldbody>
  <actuator><position joint="turn" kp="50" kv="5"/>
    <position joint="gap" kp="{kp}" kv="{kv}" ctrlrange="0 .07" forcerange="-60 60"/></actuator></mujoco>"""
PUBLISHED = RobotModel("hand", MODEL.format(damping=8, friction=1.0, kp=500, kv=25))
TRUE = MODEL.format(damping=6, friction=0.8, kp=340, kv=22)
WIDE, NEAR, THING = 0.07, 0.044, 0.016


def episode(thing: float | None, name: str = "grasp", way: tuple[float, ...] = (WIDE, NEAR, NEAR, 0.0, 0.0, WIDE)) -> Episode:
    """Open, half closed, closed onto a thing of a width (or onto nothing), open again: 25 rows a second of a hand that is not the
    published one. Where there is a thing, a stiff wall stops the finger."""
    model = mujoco.MjModel.from_xml_string(TRUE)
    data = mujoco.MjData(model)
    times = np.arange(0.0, 9.0, 0.04)
    path = np.interp(times, [0.3, 1.3, 2.2, 2.7, 5.0, 5.2], way)
    data.qpos[1] = data.ctrl[1] = WIDE
    mujoco.mj_step(model, data, 500)
    rows = []
    for command in path:
        rows.append(data.qpos.copy())
        data.ctrl[:] = 0.3 * np.sin(0.7 * len(rows) * 0.04), command
        for _ in range(20):
            data.qfrc_applied[1] = 0.0 if thing is None else 2e4 * max(0.0, thing - data.qpos[1])
            mujoco.mj_step(model, data)
    commands = np.stack([0.3 * np.sin(0.7 * times), path], axis=1)
    return Episode(name, ("turn", "gap"), times, np.array(rows), times, commands)


def test_a_stretch_ends_where_the_closing_begins_and_the_next_begins_where_its_command_lets_go() -> None:
    held = episode(THING)
    first, second = free_stretches(held, 1, WIDE)
    assert 1.3 < first.times[-1] <= 2.3 and np.array_equal(first.measured, held.position[: len(first.times)])
    begun = held.times[-1] - second.times[-1]
    assert 5.0 < begun < 5.2 and second.measured[0, 1] == pytest.approx(THING, abs=1e-3) and second.measured[-1, 1] > 0.06
    told = second.episode.command[np.searchsorted(second.episode.command_times, 0.0), 1]
    assert told == held.command[np.searchsorted(held.times, begun), 1] and told > second.measured[0, 1]


def test_what_holds_nothing_is_free_from_end_to_end() -> None:
    (whole,) = free_stretches(episode(None), 1, WIDE)
    assert np.array_equal(whole.measured, episode(None).position)


def test_what_it_holds_does_not_make_its_servo_weak() -> None:
    found = gripping(PUBLISHED, ("gap",), [episode(THING, f"grasp{n}") for n in range(3)]).joints["gap"]
    numbers = {name.partition("[")[0]: one["value"] for name, one in found["parameters"].items()}
    assert numbers["viscous.damping"] / numbers["servo_gain.kp"] == pytest.approx(28 / 340, rel=0.03)
    assert numbers["coulomb.torque"] / numbers["servo_gain.kp"] == pytest.approx(0.8 / 340, rel=0.05)
    assert found["rmse_after"] < 0.15 * found["rmse_before"] and found["free_s"] > 5.0


def test_where_it_closes_in_one_go_and_stays_closed_half_of_the_way_tells_how_it_lags() -> None:
    held = [episode(THING + 0.004 * n, f"grasp{n}", (WIDE, WIDE, WIDE, 0.0, 0.0, 0.0)) for n in range(3)]
    numbers = gripping(PUBLISHED, ("gap",), held).joints["gap"]["parameters"]
    lag = numbers["viscous.damping[gap]"]["value"] / numbers["servo_gain.kp[gap]"]["value"]
    assert lag == pytest.approx(28 / 340, rel=0.02)


def test_numbers_that_were_written_down_give_the_same_robot() -> None:
    found = gripping(PUBLISHED, ("gap",), [episode(THING)])
    again = with_numbers(PUBLISHED, found.joints)
    assert again.mjcf == found.robot.mjcf != PUBLISHED.mjcf
    assert again.model.jnt_range.tolist() == PUBLISHED.model.jnt_range.tolist()


def test_one_that_is_never_seen_free_stays_as_published() -> None:
    held = episode(THING)
    rows = slice(75, 120)
    clock = held.times[rows] - held.times[75]
    short = Episode("held", held.joints, clock, held.position[rows], clock, held.command[rows])
    opening = slice(120, 129)  # how far it reaches is known, but it has not come there yet
    clock = held.times[opening] - held.times[120]
    begun = Episode("begun", held.joints, clock, held.position[opening], clock, held.command[opening])
    found = gripping(PUBLISHED, ("gap",), [short, begun])
    assert found.robot is PUBLISHED and not found.joints["gap"]["parameters"] and found.joints["gap"]["free_s"] == 0.0


def test_a_gripping_joint_never_counts() -> None:
    assert scored(PUBLISHED, SpaceSettings(("coulomb",), grips=("gap",))).tolist() == [True, False]
    everywhere = simulated_robot(PUBLISHED, SpaceSettings(("coulomb",), grips=("gap",)))
    assert [one.targets for one in everywhere.placements] == [("turn",)]
    with pytest.raises(EdreamError, match="what a gripper holds must not count"):
        scored(PUBLISHED, SpaceSettings(("coulomb",), joints=("turn", "gap"), grips=("gap",)))
    with pytest.raises(EdreamError, match="names every joint"):
        scored(PUBLISHED, SpaceSettings(("coulomb",), grips=("turn", "gap")))
    with pytest.raises(EdreamError, match="thumb"):
        scored(PUBLISHED, SpaceSettings(("coulomb",), grips=("thumb",)))


def test_a_joint_whose_servo_holds_no_position_cannot_grip() -> None:
    text = MODEL.format(damping=8, friction=1.0, kp=500, kv=25).replace(
        '<position joint="gap" kp="500" kv="25"', '<motor joint="gap"'
    )
    with pytest.raises(EdreamError, match="grips names gap, whose servo holds no position"):
        gripping(RobotModel("hand", text), ("gap",), [episode(THING)])


def test_robots_drawn_for_trials_have_the_hand_that_was_fitted(tmp_path: Path) -> None:
    found = gripping(PUBLISHED, ("gap",), [episode(THING)])
    friction = {"value": 0.1, "interval": (0.05, 0.15), "status": "converged"}
    made = {
        "summary.json": {"parameters": {"coulomb.torque[turn]": friction}, "grips": found.joints},
        "details.json": {"correlation": {"names": ["coulomb.torque[turn]"], "values": [[1.0]]}},
    }
    drawn = drawn_physics(PUBLISHED, made, SpaceSettings(("coulomb",), grips=("gap",)), RolloutOptions(draws=2), tmp_path, 1)
    models = [mujoco.MjModel.from_xml_string(one.mjcf) for one in drawn]
    fitted = found.joints["gap"]["parameters"]["coulomb.torque[gap]"]["value"]
    assert [one.dof_frictionloss[1] for one in models] == [pytest.approx(fitted)] * 2
    assert models[0].dof_frictionloss[0] != models[1].dof_frictionloss[0]


def test_a_diagnosis_keeps_a_gripping_joint_to_its_own_fit(tmp_path: Path) -> None:
    """On a make-believe robot that is not the published one; the effect hidden on the other joint is named all the same."""
    robot = config.read(config.compose(["robot=pan_tilt"]).robot, RobotSettings, "robot").load()
    data = tmp_path / "recorded"
    record(robot, RecordConfig(data, motions=6, seconds=4.0, effects=("actuator_delay",), at=("pan",)), seed=5)
    words = ["robot=pan_tilt", f"data={data}", f"runs={tmp_path / 'runs'}", "robot.grips=[tilt]", "report.of=diagnose"]
    cfg = config.compose([*words, "diagnose.effects=[actuator_delay,viscous]", "diagnose.next_motion=false"])
    found = pipeline.make_run("diagnose", ("diagnose", "report"), cfg)[0]
    told, model = found["diagnose"]["summary.json"], found["diagnose"]["model.xml"]
    assert [one["targets"] for one in told["effects"]] == [["pan"]] and not any("tilt" in name for name in told["parameters"])
    assert told["grips"]["tilt"]["rmse_after"] < 0.2 * told["grips"]["tilt"]["rmse_before"]
    fitted = told["grips"]["tilt"]["parameters"]["coulomb.torque[tilt]"]["value"]
    assert mujoco.MjModel.from_xml_string(model).joint("tilt").frictionloss[0] == pytest.approx(fitted)
    assert 'joint name="tilt"' in found["diagnose"]["difference.txt"], "what was fitted of it stands in the difference"
    assert "Joints that hold things" in found["report"]["report.html"]
