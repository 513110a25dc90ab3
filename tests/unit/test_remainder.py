"""Gaps without a name: which formula is told, and what it remembers of the motion."""

import re
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest

from benchmarks.blind.cases import robot_of
from edream.core.episode import Episode
from edream.diagnosis import remainder, verdict
from edream.diagnosis.descent import Fit
from edream.diagnosis.left_out import left_out_errors
from edream.diagnosis.nuisance import fit_nuisance, published
from edream.diagnosis.problem import Settings, prepare
from edream.diagnosis.remainder import Remainder, find_remainder
from edream.diagnosis.swings import frequencies_in_step, main_swing
from edream.diagnosis.wording import where_it_shows
from edream.sim.robot import RobotModel

TIMES = np.arange(0.0, 8.0, 0.02)


def played(
    robot: RobotModel, rng: np.random.Generator, command: np.ndarray, torque: Callable[[mujoco.MjData, float], float]
) -> Episode:
    """A motion by MuJoCo alone, a torque [N m] of the state and the step [s] put on the tilt joint; its encoder is noisy."""
    model = robot.model
    data, dof, step = mujoco.MjData(model), model.joint("tilt").dofadr[0], float(model.opt.timestep)
    data.qpos[:2] = command[0]
    clock, passed = [], []
    for k in range(int(TIMES[-1] / step) + 1):
        data.ctrl[:2] = command[min(int(k * step / 0.02 + 1e-9), len(command) - 1)]
        clock.append(k * step)
        passed.append(data.qpos[:2].copy())
        data.qfrc_applied[dof] = torque(data, step)
        mujoco.mj_step(model, data)
    position = np.stack([np.interp(TIMES, clock, column) for column in np.array(passed).T], axis=1)
    noisy = position + rng.normal(0.0, 2e-4, position.shape)
    return Episode(f"motion_{rng.integers(1 << 30)}", robot.joints, TIMES, noisy, TIMES, command)


def described(recorded: Callable[[RobotModel, int], Episode], count: int) -> tuple[Remainder, float]:
    """The formula of so many recordings, and the mean squared error [rad^2] on those left out without it."""
    robot = robot_of("pan_tilt")
    assert robot is not None
    problem = prepare(robot, [recorded(robot, seed) for seed in range(count)], Settings())
    fit = fit_nuisance(problem)
    found = find_remainder(problem, fit)
    assert found is not None and found.real and found.joint == "tilt"
    return found, float(left_out_errors(problem, fit).mean())


def warmed(robot: RobotModel, seed: int) -> Episode:
    """A tilt joint whose dry friction melts away with the way it goes, and comes back at rest."""
    rng = np.random.default_rng(seed)
    going = np.clip(TIMES - rng.uniform(0.2, 2.0), 0.0, None)[:, None]
    heat = 0.0

    def friction(data: mujoco.MjData, step: float) -> float:
        nonlocal heat
        speed = float(data.qvel[robot.model.joint("tilt").dofadr[0]])
        torque = -0.12 * np.exp(-2.0 * heat) * np.tanh(speed / 0.01)
        heat += step * (abs(speed) - heat / 3.0)
        return torque

    return played(robot, rng, 0.5 * np.sin(going * rng.uniform(1.5, 3.0, 2)) * [1.0, 0.6], friction)


def test_friction_that_melts_as_a_joint_moves_is_described_by_how_fast_it_was_lately() -> None:
    found, left = described(warmed, 6)
    assert re.search(r"sign\(v\) mean \|v\| of the last (0\.5|2|10) s", found.formula), found.formula
    assert found.errors.mean() < 0.25 * left, "half of the error, on motions left out"


def weakened(robot: RobotModel, seed: int) -> Episode:
    """A tilt joint whose servo lacks up to two fifths of its gain [20 N m/rad] within 0.4 rad of 0.3 rad, in a triangle."""
    rng = np.random.default_rng(seed)
    phase = TIMES[:, None] * rng.uniform(1.0, 2.5, 2) + rng.uniform(0.0, 6.0, 2)

    def missing(data: mujoco.MjData, step: float) -> float:
        lost = 0.4 * max(0.0, 1.0 - abs(float(data.qpos[1]) - 0.3) / 0.4)
        return -lost * 20.0 * float(data.ctrl[1] - data.qpos[1])

    return played(robot, rng, 0.8 * np.sin(phase) * [1.0, 0.9], missing)


@pytest.mark.slow
def test_a_servo_that_is_weak_at_one_place_is_described_by_its_torque_there() -> None:
    found, left = described(weakened, 5)
    assert "motor bump(q at " in found.formula
    assert found.errors.mean() < 0.1 * left, "a third of the error, on motions left out"


def stopped(robot: RobotModel, seed: int) -> Episode:
    """A tilt joint that leans on something soft beyond 0.31 rad: 6 N m at a depth of 0.1 rad, by its power of 1.3."""
    rng = np.random.default_rng(seed)
    phase = TIMES[:, None] * rng.uniform(1.0, 2.5, 2) + rng.uniform(0.0, 6.0, 2)

    def pushed(data: mujoco.MjData, step: float) -> float:
        return -6.0 * (max(0.0, float(data.qpos[1]) - 0.31) / 0.1) ** 1.3

    return played(robot, rng, 0.8 * np.sin(phase) * [1.0, 0.9], pushed)


def test_what_a_joint_leans_on_beyond_a_place_is_described_by_that_place() -> None:
    found, left = described(stopped, 5)
    places = [float(place) for place in re.findall(r"max\(q - ([-0-9.e]+), 0\)", found.formula)]
    assert any(abs(place - 0.31) < 0.08 for place in places), found.formula
    assert found.errors.mean() < 0.02 * left, "a seventh of the error, on motions left out"


def hummed(robot: RobotModel, seed: int, phase: float, hum: float = 0.08) -> Episode:
    """A tilt joint that something pushes and pulls 1.3 times a second [N m], whatever it is told."""
    rng = np.random.default_rng(seed)
    steps = rng.uniform(-0.5, 0.5, (9, 2)).repeat(50, axis=0)[: len(TIMES)]
    return played(robot, rng, steps, lambda data, step: hum * float(np.sin(2.0 * np.pi * 1.3 * data.time + phase)))


def test_what_hums_in_step_with_the_recording_is_a_sine_in_time_and_what_has_its_own_phase_is_told_of() -> None:
    robot = robot_of("pan_tilt")
    assert robot is not None
    problem = prepare(robot, [hummed(robot, seed, 0.5) for seed in range(6)], Settings())
    fit = fit_nuisance(problem)
    found = find_remainder(problem, fit)
    assert found is not None and found.real and found.joint == "tilt"
    frequencies = {float(f) for f in re.findall(r"(?:sin|cos)\(2 pi ([\d.]+) Hz t\)", found.formula)}
    assert frequencies and all(f == pytest.approx(1.3, abs=0.02) for f in frequencies), found.formula
    numbers = found.fit.space.mapping(found.fit.values)
    refitted = [value for name, value in numbers.items() if ".frequency_" in name]
    assert refitted == [pytest.approx(1.3, abs=1e-3)], "to the digit that a recording of ten seconds shows"
    assert found.errors.mean() < 0.2 * left_out_errors(problem, fit).mean(), "a fifth of the squared error, on motions left out"

    problem = prepare(robot, [hummed(robot, seed, 2.4 * seed) for seed in range(6)], Settings())
    fit = fit_nuisance(problem)
    assert "swings at 1.3 Hz whatever the commands are" in where_it_shows(problem, fit)
    swing = main_swing(problem, fit, "tilt")
    assert swing is not None and swing.frequency == pytest.approx(1.3, abs=0.02) and 0.5 < swing.share <= 1.0


def test_no_swing_is_told_of_where_the_commands_swing_or_nothing_does() -> None:
    robot = robot_of("pan_tilt")
    assert robot is not None
    told = 0.5 * np.sin(2.0 * np.pi * 1.3 * TIMES)[:, None] * [1.0, 0.6]
    rng = np.random.default_rng(3)
    swung = [played(robot, rng, told, lambda data, step: -0.1 * float(data.qpos[1])) for _ in range(4)]
    problem = prepare(robot, swung, Settings())
    start = Fit(published(problem), np.zeros(0), published(problem).residuals(np.zeros((1, 0)))[0], np.zeros((0, 0)), 1.0)
    assert main_swing(problem, start, "tilt") is None and frequencies_in_step(problem, start, "tilt") == []
    problem = prepare(robot, [hummed(robot, seed, 0.5, hum=0.0) for seed in range(6)], Settings())
    assert where_it_shows(problem, fit_nuisance(problem)) in (" It shows most on pan.", " It shows most on tilt.")


def asked_for(monkeypatch: pytest.MonkeyPatch, names: int, first: float, left: float, beside: float, alone: float | None) -> str:
    """Which formula is told, "beside" the names, "alone" or "none", where errors on motions left out are so many floors."""
    floor = 3e-4
    told = {True: beside, False: alone}
    made = {
        by: one and SimpleNamespace(real=True, errors=np.full(4, (one * floor) ** 2), beside_names=by) for by, one in told.items()
    }
    monkeypatch.setattr(verdict, "find_remainder", lambda problem, fit, beside_names=False: made[beside_names])
    problem: Any = SimpleNamespace(floor=floor, settings=Settings())
    errors = (np.full(4, (floors * floor) ** 2) for floors in (first, left))
    found = verdict.unexplained(problem, "before", "fit", *errors, ["one", "two"][:names])  # type: ignore[arg-type, list-item]
    return "none" if found is None else "beside" if found is made[True] else "alone"


@pytest.mark.parametrize(("share", "told"), [(1.05, "alone"), (1.5, "beside")])
def test_names_that_fall_short_go_where_a_formula_alone_does_as_well(
    share: float, told: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert asked_for(monkeypatch, 1, first=20.0, left=17.0, beside=5.0, alone=5.0 * share**0.5) == told


@pytest.mark.parametrize(("names", "left", "told"), [(2, 6.0, "beside"), (2, 2.5, "none"), (1, 6.0, "none")])
def test_a_clear_gap_that_several_names_leave_asks_for_a_formula_however_much_they_close(
    names: int, left: float, told: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A rubber stop was a spring that hardens and friction with the load: 70 mrad to 6.4, where noise explains 0.3."""
    assert asked_for(monkeypatch, names, first=100.0, left=left, beside=0.5 * left, alone=left) == told


@pytest.mark.parametrize(("names", "share", "told"), [(1, 0.25, "beside"), (1, 0.4, "none"), (2, 0.4, "beside"), (2, 0.6, "none")])
def test_a_formula_must_take_two_thirds_of_what_one_name_leaves_and_half_of_what_several_do(
    names: int, share: float, told: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert asked_for(monkeypatch, names, first=200.0, left=60.0, beside=60.0 * share**0.5, alone=None) == told


@pytest.mark.parametrize(
    ("left", "looks", "kept", "idle"),
    [
        ([5.0, 1.5], 1, 1.5, None),  # the first closes the gap
        ([60.0, 4.0], 1, 4.0, None),  # or nearly all of a large one
        ([5.0, 3.0, 2.5, 2.2], 3, 2.2, None),  # each leaves one and is better: as many as are looked for
        ([5.0, 3.0, 3.1, 1.0], 2, 3.0, None),  # the second is worse on motions left out
        ([5.0, 3.0, 2.5, 2.2], 2, 3.0, 2),  # or comes to nothing in the fit
        ([5.0, 3.0, None], 2, 3.0, None),  # nothing more explains enough
        ([5.0, None], 1, None, None),
    ],
)
def test_a_formula_is_looked_at_again_where_it_leaves_a_gap_and_as_long_as_it_gets_better(
    left: list[float | None], looks: int, kept: float | None, idle: int | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    floor = 3e-4
    problem: Any = type("Small", (), {"floor": floor, "settings": Settings()})()
    asked: list[Any] = []

    def longer(problem: Any, fit: str, joint: str, found: Any) -> tuple[Any, str] | None:
        asked.append(found and found.fit.look)
        look = len(asked)
        return None if left[look] is None else (SimpleNamespace(look=look, rms=1.0 / (look - (look == idle))), "placement")

    def errors(problem: Any, fit: Any) -> np.ndarray:
        return np.full(6, ((left[getattr(fit, "look", 0)] or 0.0) * floor) ** 2)

    monkeypatch.setattr(remainder, "_longer", longer)
    monkeypatch.setattr(remainder, "left_out_errors", errors)
    monkeypatch.setattr(remainder, "worst_joint", lambda problem, fit: "tilt")
    monkeypatch.setattr(remainder, "_formula", lambda fit, placement: "tau = ...")
    found = find_remainder(problem, "fit")  # type: ignore[arg-type]
    assert len(asked) == looks and asked[:2] == [None, 1][:looks], "each look begins where the last one ended"
    if kept is None:
        assert found is None
    else:
        assert found is not None and found.real and found.errors == pytest.approx((kept * floor) ** 2)
