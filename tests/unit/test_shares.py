"""The servo's share of a joint's damping, which only motions that reach the limit of its torque tell."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import edream
from edream.diagnosis import nuisance, steps
from edream.diagnosis.descent import polish
from edream.diagnosis.left_out import leaves_no_gap
from edream.diagnosis.naming import is_own_damping_strange, own_damping, strange_numbers
from edream.diagnosis.nuisance import fit_nuisance, with_shares
from edream.diagnosis.problem import Problem, Settings, prepare
from edream.diagnosis.steps import with_short_steps
from edream.diagnosis.suspects import least_share
from edream.diagnosis.valleys import better_place, out_of_false_valleys
from edream.reality.truth import Truth, draw
from edream.sim.beginning import all_or_nothing
from edream.sim.differences import FINE
from edream.sim.objective import STEP, Objective
from edream.sim.robot import load_robot
from edream.sim.scales import strongest
from tests.stand_in import episodes_of


def recorded(path: Path, seed: int, published: Path | None = None) -> tuple[Problem, Truth]:
    """A robot's own motions, and what is to be explained beside a model of it, the one that it was drawn from if None is told."""
    robot, model = load_robot(path), load_robot(published or path)
    truth = draw(robot, [], np.random.default_rng(seed), 0.3, ("pan", "tilt"))
    episodes = episodes_of(robot, truth, seed)
    return prepare(model, episodes, Settings()), truth


def weak(folder: Path, limit: float, gain: float = 20.0, damping: float = 0.5) -> Path:
    """A pan-tilt head whose servos give no more than so many N m, and damp, as published, about as much as the joints do."""
    text = (Path(edream.__file__).parent / "robots" / "pan_tilt.xml").read_text()
    changes = {'forcerange="-5 5"': f'forcerange="-{limit} {limit}"', 'kp="20"': f'kp="{gain}"', 'kv="0.5"': f'kv="{damping}"'}
    for before, after in changes.items():
        assert text.count(before) == 2
        text = text.replace(before, after)
    path = folder / "weak.xml"
    path.write_text(text)
    return path


def test_a_joints_own_damping_is_strange_by_itself_where_motions_tell_it_from_its_servos(tmp_path: Path) -> None:
    path, heavy = weak(tmp_path, 0.5), tmp_path / "heavy.xml"
    text = path.read_text()  # of heavy pan brakes itself five times as much as published, and its servo less than half as much
    heavy.write_text(text.replace('damping="0.10"', 'damping="0.50"', 1).replace('kv="0.5"', 'kv="0.2"', 1))
    for robot, expected in ((path, []), (heavy, [("viscous", ("pan",))])):
        problem, truth = recorded(robot, 5, published=path)
        problem, fit = with_shares(problem, fit_nuisance(problem))
        fit = polish(fit)
        strange = strange_numbers(problem, fit)
        assert [(one.name, one.targets) for one in strange] == expected
        assert all(set(one.values) == {"damping", "inside"} for one in strange)
        place = next(one for one in fit.objective.simulated.placements if one.full_name("inside") == "viscous.inside[pan]")
        low, high = own_damping(fit, place)
        assert low < truth.nuisance["damping"]["pan"] < high
        assert high - low < 0.25  # N m s/rad, where the whole alone is known to no better in heavy


def test_another_number_that_a_limit_has_inside_is_no_joints_damping(tmp_path: Path) -> None:
    problem, _ = recorded(weak(tmp_path, 0.5), 5)
    usual = (*problem.settings.nuisance, "torque_limit")
    problem = replace(problem, settings=replace(problem.settings, nuisance=usual))
    fit = fit_nuisance(problem)
    assert any(name.startswith("torque_limit.inside") for name in fit.space.names)
    assert not [one for one in strange_numbers(problem, fit) if one.name == "viscous"]


def test_what_is_ordinary_of_a_joints_own_damping(tmp_path: Path) -> None:
    model = load_robot(weak(tmp_path, 0.5)).model  # 0.1 N m s/rad of its own, 0.5 of its servo
    assert not is_own_damping_strange(model, "pan", (0.15, 0.4))
    assert is_own_damping_strange(model, "pan", (0.22, 0.4))
    assert not is_own_damping_strange(model, "pan", (0.0, 0.05))  # so little of the whole says nothing


def test_motions_that_reach_a_limit_tell_the_share_and_it_becomes_true(tmp_path: Path) -> None:
    problem, truth = recorded(weak(tmp_path, 0.5), 4)
    usual = fit_nuisance(problem)
    shared, fit = with_shares(problem, usual)
    assert shared.shared, "the motions must reach the limit"
    assert fit.rms <= usual.rms
    fit = polish(fit)
    found, intervals = fit.space.mapping(fit.values), fit.intervals()
    for (joint,) in shared.shared:
        servo, bare = truth.nuisance["kd"][joint], truth.nuisance["damping"][joint]
        low, high = intervals[f"viscous.inside[{joint}]"]
        assert found[f"viscous.inside[{joint}]"] == pytest.approx(servo / (servo + bare), abs=max(0.05, high - low))


def test_motions_below_the_limit_leave_the_share_as_published(tmp_path: Path) -> None:
    problem, _ = recorded(weak(tmp_path, 50.0), 4)
    usual = fit_nuisance(problem)
    same, fit = with_shares(problem, usual)
    assert same is problem and fit is usual


@pytest.mark.parametrize(("limit", "gain", "step"), [(0.6, 400.0, FINE), (50.0, 20.0, STEP)])
def test_differences_are_fine_where_servos_reach_their_limit(tmp_path: Path, limit: float, gain: float, step: float) -> None:
    problem, _ = recorded(weak(tmp_path, limit, gain), 1)
    assert fit_nuisance(problem).objective.step == step


@pytest.mark.slow
def test_soft_servos_are_found_that_were_published_so_stiff_that_they_always_reach_their_limit(tmp_path: Path) -> None:
    soft, stiff = (tmp_path / name for name in ("soft", "stiff"))
    soft.mkdir()
    stiff.mkdir()
    problem, truth = recorded(weak(soft, 1.0, 15.0, 1.0), 4, published=weak(stiff, 1.0, 1000.0, 2.0))
    usual = fit_nuisance(problem)
    assert usual.objective.step == STEP
    problem, fit = with_shares(problem, usual)
    assert leaves_no_gap(problem, fit)
    found = fit.space.mapping(polish(fit).values)
    for joint in problem.joints:
        assert found[f"servo_gain.kp[{joint}]"] == pytest.approx(truth.nuisance["kp"][joint], rel=0.15)


def test_the_step_of_differences_is_chosen_anew_where_the_usual_numbers_were_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    problem, _ = recorded(weak(tmp_path, 50.0), 4)
    places: list[np.ndarray] = []

    def chosen(objective: Objective, unit: np.ndarray) -> Objective:
        places.append(objective.simulated.space.from_unit(unit))
        return replace(objective, step=FINE) if len(places) == 1 else objective

    monkeypatch.setattr(nuisance, "with_straight_step", chosen)
    fit = fit_nuisance(problem)
    assert fit.objective.step == STEP
    first, last = (np.abs(place / fit.values - 1.0).max() for place in places)
    assert last < 0.1 < first


@pytest.mark.slow
def test_stiff_servos_at_their_limit_are_led_out_of_a_false_valley(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    problem, _ = recorded(weak(tmp_path, 0.6, gain=400.0, damping=2.0), 1)
    shared, usual = with_shares(problem, fit_nuisance(problem))
    with monkeypatch.context() as without:
        without.setattr(steps, "out_of_false_valleys", lambda problem, fit: fit)
        _, stuck = with_short_steps(shared, usual)
    _, fit = with_short_steps(shared, usual)
    assert stuck.rms > 4.0 * problem.floor, "the plain descent must end in a false valley"
    assert fit.rms < 0.5 * stuck.rms
    assert out_of_false_valleys(problem, stuck) is stuck, "no group of these is said to reach its limit"
    place = better_place(shared, stuck, [("tilt",)])
    assert place is None or all("tilt" in stuck.space.names[k] for k in np.flatnonzero(place != stuck.unit))


def test_a_limit_of_the_joint_counts_as_one_of_its_servo(tmp_path: Path) -> None:
    path = weak(tmp_path, 50.0, gain=1000.0)
    free = load_robot(path).model
    text = path.read_text()
    start = text.index("<joint ", text.index("<worldbody>")) + len("<joint ")
    path.write_text(text[:start] + 'actuatorfrcrange="-3 3" ' + text[start:])
    model = load_robot(path).model
    (limited,) = (model.joint(number).name for number in np.flatnonzero(model.jnt_actfrclimited))
    assert strongest(free, limited) == 50.0 and not all_or_nothing(free, limited)
    assert strongest(model, limited) == 3.0 and all_or_nothing(model, limited)


def test_an_ordinary_damping_of_the_joints_own_bounds_the_servos_share(tmp_path: Path) -> None:
    model = load_robot(weak(tmp_path, 0.5)).model  # 0.1 N m s/rad of its own, 0.5 of its servo
    assert least_share(model, "pan") == pytest.approx(1.0 - (1.35 * 0.1 + 0.1 * 0.6) / (1.35 * 0.6))
    most = 1.35 * 0.6 * (1.0 - least_share(model, "pan"))
    assert not is_own_damping_strange(model, "pan", (most - 1e-6, 1.0)) and is_own_damping_strange(model, "pan", (most + 1e-6, 1.0))
