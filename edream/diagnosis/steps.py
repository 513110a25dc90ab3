"""How long the simulator's steps may be: so short that shorter ones would not move the robot otherwise."""

from collections.abc import Mapping
from dataclasses import replace

import mujoco
import numpy as np

from edream.core.parameters import targets_in
from edream.diagnosis.descent import Fit, begin, descend
from edream.diagnosis.problem import VISIBLE, Problem
from edream.diagnosis.valleys import out_of_false_valleys
from edream.sim.objective import Objective, rms
from edream.sim.robot import RobotModel
from edream.sim.servo import share_within_limit
from edream.sim.simulation import SimulatedRobot

SHORTER = 4  # times: the step that a replay is compared with
HALVINGS = 3
WORTH = 0.9  # of the error that longer steps leave
LEAST = 0.5  # of the error: what less than that differs by cannot be worth so much
UNLIKE = 10.0  # errors: so far apart, steps of two lengths make two robots
LENGTHS = 3  # of steps, each half of the one before, that a plain loop may get
AS_NEAR = 1.02  # times the error with commands between steps: what a plain loop may leave
DAMPING, INERTIA = "viscous.damping", "armature.inertia"


def with_short_steps(problem: Problem, fit: Fit) -> tuple[Problem, Fit]:
    """The problem and its fit, with steps as short as its servos ask for.

    The error of MuJoCo's integrators (all but Runge-Kutta) goes with the step h. A command would act half a step early, but is
    given half a step late (`edream.sim.rollout`). A damping d acts half a step late, which less inertia would make up for
    (`moved`). What is left is no effect of the robot's, and must not be taken for one: steps are halved as long as that closes a
    tenth of a visible error. Where that leaves a gap and servos reach their limits, the numbers may stand in a false valley: they
    are led out of it, and from there steps are halved again.
    """
    problem, fit = _halved(problem, fit)
    found = out_of_false_valleys(problem, fit)
    return (problem, fit) if found is fit else _halved(problem, found)


def _halved(problem: Problem, fit: Fit) -> tuple[Problem, Fit]:
    """The problem and its fit with steps halved while that is worth it."""
    for _ in range(HALVINGS):
        if not may_tell(problem, fit):
            break
        robot = replace(problem.robot, step=float(problem.robot.model.opt.timestep) / 2.0)
        objective, unit, residual = _replayed(fit, robot)
        begun = replace(fit, objective=objective, unit=unit, residual=residual, ended=False)
        if is_under_resolved(problem.robot.model, fit.space.mapping(fit.values)):  # next to nothing was to be felt of inertia
            begun = begin(objective, unit)
        found = descend(begun, None, iterations=3)
        if found.rms >= WORTH * fit.rms:
            break
        problem, fit = replace(problem, robot=robot), found
    return problem, fit


def in_a_plain_loop(problem: Problem) -> Problem:
    """The problem with a robot that gets commands at steps, as `edream replay` and any loop of `mj_step` give them."""
    return replace(problem, robot=replace(problem.robot, timed=False))


def for_a_plain_loop(problem: Problem, fit: Fit) -> tuple[Problem, Fit]:
    """The problem and its fit for any loop, which gives a command at the first step at or after its time.

    A command that was recorded between two steps is then late by up to one, each by something else, for which no number makes up.
    Steps are halved until that is worth next to nothing, and the numbers moved to suit them, by the slopes that they had.
    """
    plain, near = in_a_plain_loop(problem).robot, fit
    for halvings in range(LENGTHS):
        if halvings:
            plain = replace(plain, step=float(plain.model.opt.timestep) / 2.0)
        objective, unit, residual = _replayed(fit, plain)
        begun = replace(fit, objective=objective, unit=unit, residual=residual)
        # what these steps tell of slopes is along themselves: where numbers go together it would make intervals far too narrow
        near = replace(descend(begun, np.zeros(len(unit), bool), iterations=2), jacobian=fit.jacobian, ended=fit.ended)
        if near.rms <= AS_NEAR * fit.rms:
            break
    return replace(problem, robot=plain), near


def with_long_steps(problem: Problem, fit: Fit) -> Fit:
    """The fit with the published steps where they were made shorter, and the same residual there: quicker, for first looks.

    What the length of the steps changes is added to every residual. What an effect does to a motion depends on it little. A model
    that long steps make unstable stays as it is.
    """
    if problem.robot.step is None:
        return fit
    simulated = SimulatedRobot(problem.robot.published, fit.objective.simulated.placements)
    objective = replace(fit.objective, simulated=simulated, simulations=0, offset=None)
    there = objective.residuals(fit.values)[0]
    if rms(there - fit.residual) >= UNLIKE * max(fit.rms, problem.floor):
        return fit
    return replace(fit, objective=replace(objective, offset=fit.residual - there))


def may_tell(problem: Problem, fit: Fit) -> bool:
    """Whether an error can be seen, and shorter steps move the robot so differently that this may be the error.

    What inertia makes up for counts as well where there is none left for it: no number can be small enough for such steps.
    """
    model = problem.robot.model
    if not first_order(model) or fit.rms <= (1.0 + VISIBLE) * problem.floor:
        return False
    under_resolved = is_under_resolved(model, fit.space.mapping(fit.values))
    _, _, residual = _replayed(fit, replace(problem.robot, step=float(model.opt.timestep) / SHORTER), makes_up=not under_resolved)
    return rms(residual - fit.residual) / (1.0 - 1.0 / SHORTER) >= LEAST * fit.rms


def is_under_resolved(model: mujoco.MjModel, values: Mapping[str, float]) -> bool:
    """Whether steps hide a joint's inertia behind what late damping adds to it, as where a stiff servo comes to rest within one.

    `values`: full parameter name -> value, among them damping [N m s/rad] and inertia [kg m^2].
    """
    later = moved(model, values, float(model.opt.timestep))
    return any(name.startswith(INERTIA) and later[name] > 2.0 * value for name, value in values.items())


def first_order(model: mujoco.MjModel) -> bool:
    """Whether the error of a model's integrator goes with the first power of its step."""
    return int(model.opt.integrator) != int(mujoco.mjtIntegrator.mjINT_RK4)


def moved(model: mujoco.MjModel, values: Mapping[str, float], less: float) -> dict[str, float]:
    """Usual numbers with which steps that are shorter by `less` [s] move a robot smoothly as these do.

        I' = I + s d less / 2

    with s = 1 for damping that is implicit, -1 for damping that is not (a servo's under the Euler method).
    Source: the modified equation of the semi-implicit Euler method, Hairer, Lubich, Wanner, Geometric Numerical Integration,
    chapter IX. `less` is the whole step for numbers of the robot itself, in continuous time.

    Args:
        model: with the longer steps.
        values: full parameter name -> value, among them damping [N m s/rad] and inertia [kg m^2]; all others stay as they are.
    """
    out = dict(values)
    for name, value in values.items():
        quantity, _, place = name.partition("[")
        if quantity == INERTIA:
            late = _lateness(model, next(iter(targets_in(name))))
            out[name] = value + late * values.get(f"{DAMPING}[{place}", 0.0) * less / 2.0
    return out


def _lateness(model: mujoco.MjModel, joint: str) -> float:
    """The mean of s over a joint's damping and its servo's."""
    if int(model.opt.integrator) != int(mujoco.mjtIntegrator.mjINT_EULER):
        return 1.0
    implicit = not int(model.opt.disableflags) & int(mujoco.mjtDisableBit.mjDSBL_EULERDAMP)
    inside = share_within_limit(model, joint)
    return (1.0 - inside) * (1.0 if implicit else -1.0) - inside


def in_continuous_time(problem: Problem, values: Mapping[str, float]) -> dict[str, float]:
    """Usual numbers as the robot itself has them, by what was fitted with the simulator's steps."""
    model = problem.robot.model
    return moved(model, values, float(model.opt.timestep)) if first_order(model) else dict(values)


def _replayed(fit: Fit, robot: RobotModel, makes_up: bool = True) -> tuple[Objective, np.ndarray, np.ndarray]:
    """The objective with a robot of other steps, the unit-box numbers with which it moves most as the fit does, (P,), and the
    residual there [rad], (R,). They are the fit's own, or if it `makes_up` those that make up for the steps on smooth motions."""
    before = fit.objective.simulated
    simulated = SimulatedRobot(robot, before.placements)
    objective, space = replace(fit.objective, simulated=simulated, simulations=0), simulated.space
    found, less = fit.space.mapping(fit.values), float(before.model.opt.timestep) - float(robot.model.opt.timestep)
    more = [moved(before.robot.model, found, less)] if makes_up else []
    sets = np.array([space.vector(one) for one in (found, *more)])
    residuals = objective.residuals(sets)
    nearest = int(np.argmin([rms(residual - fit.residual) for residual in residuals]))
    return objective, np.clip(space.to_unit(sets[nearest]), 0.0, 1.0), residuals[nearest]
