"""Steps that are too long for a servo are no effect of the robot's."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from edream.diagnosis.candidates import Candidate, placement
from edream.diagnosis.descent import Fit, descend
from edream.diagnosis.naming import strange_numbers
from edream.diagnosis.never_fitted import unstable_on
from edream.diagnosis.nuisance import fit_nuisance, published
from edream.diagnosis.problem import Problem
from edream.diagnosis.screen import extend, with_quantities
from edream.diagnosis.steps import (
    for_a_plain_loop,
    in_continuous_time,
    is_under_resolved,
    may_tell,
    moved,
    with_long_steps,
    with_short_steps,
)
from edream.diagnosis.trials import gone_on
from edream.diagnosis.wording import on_steps
from edream.sim.emit import emit
from edream.sim.objective import rms
from edream.sim.open_loop import open_loop
from edream.sim.robot import RobotModel
from edream.sim.simulation import SimulatedRobot
from tests.still_problem import fit_of, pan_tilt, still_problem

FINE = 0.000125  # s: a sixteenth of the published step


def stiff(gains: str = 'kp="400" kv="4"') -> RobotModel:
    """The arm with servos twenty times as stiff, or of other gains, and without a limit."""
    robot = pan_tilt()
    return replace(robot, mjcf=robot.mjcf.replace('kp="20" kv="0.5"', gains).replace('forcerange="-5 5"', ""))


@pytest.fixture(scope="module")
def coarse() -> tuple[Problem, Fit]:
    """What an arm with such servos did, and its fit with the published step."""
    problem = still_problem(stiff(), FINE, jump=1.0)
    return problem, fit_nuisance(problem)


def test_on_smooth_motions_other_numbers_make_up_for_another_step() -> None:
    problem = still_problem()
    fit = fit_of(problem)
    step = float(problem.robot.model.opt.timestep)
    simulated = SimulatedRobot(replace(problem.robot, step=step / 8), fit.objective.simulated.placements)
    fine = replace(fit.objective, simulated=simulated, simulations=0)
    names = fit.space.mapping(fit.values)
    sets = [names, moved(problem.robot.model, names, step * 7 / 8)]
    as_they_are, made_up = fine.residuals(np.array([simulated.space.vector(one) for one in sets])) - fit.residual
    assert np.abs(made_up).mean() < 0.5 * np.abs(as_they_are).mean()


def test_damping_that_a_servo_does_explicitly_is_late_the_other_way() -> None:
    text = pan_tilt().mjcf
    values = {"viscous.damping[tilt]": 0.6, "armature.inertia[tilt]": 0.01, "servo_gain.kp[tilt]": 20.0}
    late = {}
    for integrator in ("implicitfast", "Euler", "RK4"):
        problem = still_problem(replace(pan_tilt(), mjcf=text.replace('integrator="implicitfast"', f'integrator="{integrator}"')))
        found = in_continuous_time(problem, values)
        late[integrator] = found["armature.inertia[tilt]"] - 0.01
        assert found["viscous.damping[tilt]"] == 0.6
    assert late["implicitfast"] == pytest.approx(0.6 * 0.001)
    assert late["Euler"] == pytest.approx((0.1 - 0.5) * 0.001)  # the servo has a limit, and 0.5 of the 0.6 are its own
    assert late["RK4"] == 0.0


def test_steps_are_halved_where_that_closes_a_visible_error(coarse: tuple[Problem, Fit]) -> None:
    problem, fit = coarse
    shorter, found = with_short_steps(problem, fit)
    assert shorter.robot.step is not None and shorter.robot.step < 0.002
    assert fit.rms > 1.5 * problem.floor
    assert found.rms < 0.5 * fit.rms
    assert "steps of 2 ms are too long" in on_steps(shorter, shorter, False)
    assert [one.name for one in strange_numbers(shorter, found)] == []
    made = emit(found.objective.simulated, found.values)
    assert mujoco.MjModel.from_xml_string(made.mjcf).opt.timestep == shorter.robot.step
    assert "timestep" in made.difference


def test_steps_are_halved_where_no_inertia_is_small_enough_for_them() -> None:
    problem = still_problem(stiff('kp="2000" kv="100"'), FINE, jump=1.0)
    fit = fit_nuisance(problem)
    assert is_under_resolved(problem.robot.model, fit.space.mapping(fit.values))
    shorter, found = with_short_steps(problem, fit)
    assert shorter.robot.step is not None
    assert found.rms < 0.9 * fit.rms


def test_a_published_model_that_its_own_steps_make_unstable_is_known_by_the_motions() -> None:
    implicit = stiff('kp="2000" kv="100"')
    explicit = replace(implicit, mjcf=implicit.mjcf.replace('integrator="implicitfast"', 'integrator="Euler"'))
    for robot, blown in ((explicit, True), (pan_tilt(), False)):
        problem = still_problem(robot, FINE)
        start = Fit(published(problem), np.zeros(0), np.zeros(0), np.zeros((0, 0)), 1.0)
        assert unstable_on(problem, start) == (tuple(window.episode.name for window in problem.proof) if blown else ())


def test_first_looks_in_the_published_steps_see_what_shorter_ones_would(coarse: tuple[Problem, Fit]) -> None:
    problem, fit = with_short_steps(*coarse)
    quick = with_long_steps(problem, fit)
    assert quick.objective.simulated.model.opt.timestep == 0.002
    np.testing.assert_allclose(quick.objective.residuals(fit.values)[0], fit.residual, atol=1e-12)
    place = placement(problem, Candidate("constant_torque", ("tilt",)))
    moved_by = []
    for one in (fit, quick):
        extended, absent = extend(one, [place])
        there, here = extended.residuals(np.array([with_quantities(extended, absent, [place], [{"torque": 1.0}]), absent]))
        moved_by.append(there - here)
    assert rms(moved_by[1] - moved_by[0]) < 0.1 * rms(moved_by[0])
    begun = replace(quick, objective=extend(quick, [place])[0])  # a candidate's first steps; the next ones are short again
    with_it = replace(begun, unit=np.append(fit.unit, 0.5), jacobian=np.zeros((len(fit.residual), len(fit.unit) + 1)))
    assert gone_on(fit, with_it).objective.simulated.model.opt.timestep == problem.robot.step
    assert gone_on(fit, with_it).objective.offset is None


def test_steps_that_were_not_shortened_are_as_long_as_they_may_be(fit: Fit, problem: Problem) -> None:
    assert with_long_steps(problem, fit) is fit


def test_steps_stay_as_they_are_where_recordings_were_made_with_them(fit: Fit, problem: Problem) -> None:
    assert not may_tell(problem, fit)
    assert not is_under_resolved(problem.robot.model, fit.space.mapping(fit.values))
    assert with_short_steps(problem, fit) == (problem, fit)
    plain, near = for_a_plain_loop(problem, fit)  # nor where a plain loop meets them as well
    assert plain.robot.step is None and not plain.robot.timed
    assert near.rms < 1.02 * fit.rms
    assert on_steps(problem, plain, False) == ""
    assert on_steps(problem, plain, True) == " As published it is unstable with steps of 2 ms."


def test_commands_between_steps_ask_a_plain_loop_for_shorter_ones() -> None:
    problem = still_problem(step=FINE, jitter=5e-4)
    fit = descend(fit_of(problem), None, 4)
    assert fit.rms < 1.05 * problem.noise_floor  # with steps of 2 ms, and commands at their own times
    plain, near = for_a_plain_loop(problem, fit)
    assert plain.robot.step is not None and not plain.robot.timed
    assert near.rms < 1.02 * fit.rms
    coarse = SimulatedRobot(replace(plain.robot, step=None), near.objective.simulated.placements)
    assert rms(replace(near.objective, simulated=coarse).residuals(fit.values)) > 1.2 * fit.rms
    assert f"model.xml has steps of {1e3 * plain.robot.step:.3g} ms" in on_steps(problem, plain, False)
    made = emit(near.objective.simulated, near.values)
    robot = replace(plain.robot, mjcf=made.mjcf, step=None)
    replayed = open_loop(robot, problem.fitted)  # as any loop of mj_step has it
    errors = np.concatenate([(p - w.measured)[1:].ravel() for p, w in zip(replayed, problem.fitted, strict=True)])
    assert rms(errors) == pytest.approx(near.rms, rel=1e-4)
