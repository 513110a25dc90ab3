"""Dry friction that lets a stuck joint creep: its law in MuJoCo, and when a diagnosis makes it a usual number."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

import edream
from edream import catalog
from edream.core.effect import Effect
from edream.diagnosis.candidates import Candidate
from edream.diagnosis.creep import (
    FAR,
    Creeping,
    creeping,
    creeping_with,
    is_far_ahead,
    is_made_so,
    is_missing_beside,
    outdoes,
    quiet_ones_alone,
)
from edream.diagnosis.descent import Fit
from edream.diagnosis.evidence import evidence
from edream.diagnosis.left_out import leaves_no_gap
from edream.diagnosis.nuisance import fit_nuisance, published
from edream.diagnosis.problem import Problem, Settings, prepare
from edream.diagnosis.screen import Scored
from edream.diagnosis.trials import Trial, predicted, refit
from edream.diagnosis.verdict import diagnose
from edream.reality.truth import Truth, draw
from edream.sim.emit import emit
from edream.sim.robot import RobotModel, load_robot
from edream.sim.simulation import Placement, SimulatedRobot
from tests.stand_in import episodes_of
from tests.still_problem import having

HEAD = load_robot(Path(edream.__file__).parent / "robots" / "pan_tilt.xml", site="ee")
WHEEL = """<mujoco><option timestep="0.002" gravity="0 0 0"/><worldbody><body><joint name="turn" axis="0 0 1" damping="0"/>
  <geom type="box" size="0.1 0.1 0.1" mass="3"/></body></worldbody>
  <actuator><position name="turn" joint="turn" kp="1e-6"/></actuator></mujoco>"""
FORMS = catalog.load("effects", "coulomb", Effect).softer


def pushed(form: Effect, torque: float, creep: float) -> float:
    """How fast a wheel with dry friction of 0.5 N m turns after a second under a torque [rad/s], in the model that is written."""
    simulated = SimulatedRobot(RobotModel("wheel", WHEEL), (Placement(form, ("turn",)),))
    made = emit(simulated, {"coulomb.torque[turn]": 0.5, "coulomb.creep[turn]": creep})
    model = mujoco.MjModel.from_xml_string(made.mjcf)
    data = mujoco.MjData(model)
    data.qfrc_applied[0] = torque
    mujoco.mj_step(model, data, 500)
    return float(data.qvel[0])


@pytest.mark.parametrize("form", FORMS, ids=["at once", "slowly"])
def test_a_stuck_joint_creeps_in_proportion_to_what_pulls_at_it(form: Effect) -> None:
    for creep in (1e-4, 3e-3, 3e-2):
        for share in (0.3, 0.8):
            assert pushed(form, share * 0.5, creep) == pytest.approx(share * creep, rel=0.02)


@pytest.mark.parametrize("form", FORMS, ids=["at once", "slowly"])
def test_a_joint_that_is_pulled_harder_than_its_friction_slides(form: Effect) -> None:
    inertia = 3.0 * 0.2**2 / 6.0
    assert pushed(form, 0.7, 3e-3) == pytest.approx((0.7 - 0.5) / inertia, rel=0.02)


def smooth(speed: float, effects: tuple[str, ...] = (), seed: int = 4) -> Truth:
    """A pan-tilt head whose dry friction comes up over so many rad/s."""
    drawn = draw(HEAD, effects, np.random.default_rng(seed), 0.3, ("tilt",))
    return Truth(drawn.robot, drawn.effects, drawn.nuisance, smooth=speed)


def test_a_robot_with_smooth_friction_lacks_nothing_and_its_joints_creep_as_fast_as_they_do() -> None:
    found = diagnose(prepare(HEAD, episodes_of(HEAD, smooth(0.01), 4), Settings()))
    assert found.verdict == "none" and found.before is found.after
    assert found.sentence.startswith("Your simulator agrees")
    assert "does not hold a stuck joint, which creeps" in found.sentence
    assert found.problem.creep in FORMS
    assert leaves_no_gap(found.problem, found.after)
    rows = {row["name"]: row for row in evidence(found)["nuisance.json"]}
    numbers = found.after.space.mapping(found.after.values)
    for joint in HEAD.joints:
        assert 0.005 < numbers[f"coulomb.creep[{joint}]"] < 0.025
        assert rows[f"coulomb.creep[{joint}]"]["published"] == 0.0
        assert rows[f"coulomb.creep[{joint}]"]["after"]["value"] == numbers[f"coulomb.creep[{joint}]"]


def test_friction_that_holds_is_not_taken_for_one_that_creeps() -> None:
    problem = prepare(HEAD, episodes_of(HEAD, smooth(0.0, ("stribeck",)), 4), Settings())
    fit = fit_nuisance(problem)
    assert not leaves_no_gap(problem, fit)
    errors = predicted(problem, fit, None)
    found = creeping(problem, fit, errors)
    true = Trial(None, 1.0, fit, np.full(len(errors), problem.floor**2), 1.0, True)
    assert found is None or not outdoes(found, [true], 0)


@pytest.mark.parametrize(("closed", "ahead"), [((0.9 * FAR, -2.0), True), ((0.1, 1.1 * FAR), False), ((), True)])
def test_friction_that_creeps_is_taken_before_any_search_where_no_effect_comes_near_what_it_closes(
    closed: tuple[float, ...], ahead: bool
) -> None:
    problem = prepare(HEAD, episodes_of(HEAD, smooth(0.01), 2), Settings())
    floor = np.full(2, problem.floor**2)
    trials = [Trial(None, 1.0, None, floor, one, False) for one in closed]
    assert is_far_ahead(Creeping(problem, None, floor), problem, 9.0 * floor, trials) is ahead


def test_friction_that_creeps_on_all_joints_is_missing_beside_an_effect_that_does_more() -> None:
    truth = smooth(0.03, ("parallel_spring",))
    weak = replace(truth.effects[0], values=truth.effects[0].values | {"stiffness": 0.1})
    problem = prepare(HEAD, episodes_of(HEAD, replace(truth, effects=(weak,)), 4), Settings(threads=1))
    fit = fit_nuisance(problem)
    errors = predicted(problem, fit, None)
    found = creeping(problem, fit, errors)
    spring = Scored(Candidate("spring", ("tilt",)), {"stiffness": 1.0, "reference": 0.0}, 0.5)
    assert found is not None
    assert is_missing_beside(found, problem, [refit(problem, fit, errors, spring)])
    assert not is_missing_beside(found, problem, [])


@pytest.mark.parametrize(
    ("left", "joints", "missing"),
    [
        (1.0, [1.1, 1.2, 1.1], True),
        (3.0, [1.1, 1.2, 1.1], False),  # together they leave nearly what the better one does
        (1.0, [0.5, 3.0, 3.0], False),  # one joint alone creeps: that may be an effect on it
    ],
)
def test_friction_that_creeps_is_missing_where_most_joints_say_so(
    monkeypatch: pytest.MonkeyPatch, left: float, joints: list[float], missing: bool
) -> None:
    problem = SimpleNamespace(floor=1.0, joints=("a", "b", "c"))

    def residual(errors: list[float]) -> np.ndarray:
        return np.tile(errors, (5, 1)).ravel()

    both = SimpleNamespace(residual=residual([left * error for error in joints]))
    monkeypatch.setattr("edream.diagnosis.creep.on_few", lambda problem, fit: SimpleNamespace(rms=3.5))
    monkeypatch.setattr("edream.diagnosis.creep._beside", lambda found, few, best: both)
    monkeypatch.setattr("edream.diagnosis.creep.residual_among", lambda few, fit: residual([4.0, 4.0, 4.0]))
    found = Creeping(problem, None, np.zeros(6))  # type: ignore[arg-type]
    best = Trial(None, 1.0, None, np.zeros(6), 0.5, True)  # type: ignore[arg-type]
    assert is_missing_beside(found, problem, [best, replace(best, closed=0.9, sure=False)]) is missing  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def desk() -> tuple[Problem, Callable[..., Fit]]:
    """An arm of four joints, and its published model as far off as one says on each of them [floors]."""
    robot = load_robot(Path(edream.__file__).parents[1] / "benchmarks" / "robots" / "desk4.xml")
    problem = prepare(robot, episodes_of(robot, draw(robot, (), np.random.default_rng(4), 0.3), 4, 4, 1.0), Settings())
    objective = published(problem)
    rows = objective.residuals(np.zeros((1, 0)))[0].reshape(-1, 4)

    def off(*errors: float) -> Fit:
        residual = (rows * errors * problem.floor / np.sqrt((rows**2).mean(axis=0))).ravel()
        return Fit(objective, np.zeros(0), residual, np.zeros((len(residual), 0)), 1.0)

    return problem, off


def test_joints_that_are_off_far_more_than_the_others_are_left_out_of_what_those_are_asked(
    desk: tuple[Problem, Callable[..., Fit]],
) -> None:
    problem, off = desk
    (quiet,) = quiet_ones_alone(problem, off(4.0, 5.0, 11.0, 4.0))
    assert quiet.rms == pytest.approx(np.sqrt((4.0**2 + 5.0**2 + 4.0**2) / 3.0) * problem.floor)
    all_joints = quiet.objective.windows[0].measured[1:]
    assert quiet.objective.measured[0] == pytest.approx(all_joints[:, [0, 1, 3]])
    assert len(quiet.objective.residuals(np.zeros((1, 0)))[0]) == len(quiet.residual)
    assert quiet_ones_alone(problem, off(5.0, 6.0, 9.0, 4.0)) == [], "none is off far more than the others"
    assert quiet_ones_alone(problem, off(1.0, 1.0, 11.0, 12.0)) == [], "two do not speak for all"


def test_what_quiet_joints_have_alike_is_how_a_robot_is_made_unless_an_effect_explains_it(
    desk: tuple[Problem, Callable[..., Fit]],
) -> None:
    problem, off = desk
    fit, none = off(4.0, 4.0, 30.0, 4.0), np.zeros(3)
    creeps = Creeping(problem, off(1.1, 1.2, 30.0, 1.1), none)
    own = Trial(None, 1.0, off(4.0, 4.0, 1.0, 4.0), none, 0.9, True)  # type: ignore[arg-type]
    assert is_made_so(creeps, problem, fit, [own])
    assert not is_made_so(creeps, problem, fit, [own, replace(own, fit=off(1.2, 1.1, 29.0, 1.1))])
    assert is_made_so(creeps, problem, fit, [replace(own, fit=off(1.2, 1.1, 29.0, 1.1), sure=False)])
    assert not is_made_so(Creeping(problem, off(3.5, 3.0, 20.0, 3.5), none), problem, fit, [])
    assert not is_made_so(creeps, problem, off(4.0, 5.0, 6.0, 4.0), []), "no joint is loud"
    assert not is_made_so(Creeping(problem, off(1.0, 1.0, 30.0, 1.0), none), problem, off(1.3, 1.3, 30.0, 1.3), []), "hardly a gap"


@pytest.mark.parametrize(("effect", "motions"), [("asymmetric_coulomb", 6), ("directional_efficiency", 8)])
def test_friction_that_differs_between_directions_is_named_where_joints_creep(effect: str, motions: int) -> None:
    found = diagnose(prepare(HEAD, episodes_of(HEAD, smooth(0.005, (effect,), 8), motions), Settings()))
    assert found.verdict == "named"
    assert [(one.name, one.targets) for one in found.effects] == [(effect, ("tilt",))]
    assert found.problem.creep in FORMS
    assert leaves_no_gap(found.problem, found.after)


def test_an_effect_that_does_nothing_beside_friction_that_holds_is_sought_together_with_friction_that_creeps() -> None:
    problem = prepare(HEAD, episodes_of(HEAD, smooth(0.005, ("asymmetric_coulomb",), 8), 6), Settings())
    fit = fit_nuisance(problem)
    together = creeping_with(problem, fit, [])
    assert together is not None
    softer, lead = together
    assert lead.candidate == Candidate("asymmetric_coulomb", ("tilt",))
    assert lead.fit.rms < 1.1 * problem.floor < softer.fit.rms
    explained = replace(lead, closed=1.0)
    assert creeping_with(problem, fit, [explained]) is None
    assert creeping_with(problem, having(problem, fit, lead.candidate, {"asymmetry": 0.1}), []) is None, "it is named already"
    holding = prepare(HEAD, episodes_of(HEAD, smooth(0.0, ("stribeck",), 8), 4), Settings())
    assert creeping_with(holding, fit_nuisance(holding), []) is None
