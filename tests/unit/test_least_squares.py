"""Jacobians that share simulations lead to the same place as exact ones, for less."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from edream.core.parameters import Parameter, ParameterSpace
from edream.sim.differences import blocks, jacobian, jacobian_along_axes, nearly, sharing, straight
from edream.sim.least_squares import solve
from edream.sim.objective import STEP, Objective, rms
from edream.sim.polish import finish
from edream.sim.window import whole
from tests.recovery.planted import arm, motions, plant


def objective(seed: int = 3) -> Objective:
    simulated = arm()
    return Objective(simulated, whole(motions(simulated, plant(simulated, seed), seed, 2, 4.0)), np.arange(7) < 6, stride=2)


def test_parameters_of_different_joints_share_a_simulation_and_those_of_one_joint_do_not() -> None:
    acts = objective().acts_on
    groups = sharing(acts)
    assert sorted(p for group in groups for p in group) == list(range(24)) and len(groups) == 4
    assert all(acts[group].sum(axis=0).max() == 1 for group in groups)


def test_a_shared_column_is_nearly_the_exact_one_on_the_joint_that_it_acts_on() -> None:
    one = objective()
    space = one.simulated.space
    unit = space.to_unit(space.start())
    base = one.residuals(space.start())[0]
    exact, cheap = jacobian(one, space, unit, base), nearly(one, space, unit, base)
    own = cheap != 0.0
    likeness = [np.corrcoef(exact[own[:, p], p], cheap[own[:, p], p])[0, 1] for p in range(len(unit))]
    assert np.median(likeness) > 0.95 and min(likeness) > 0.5


def test_a_search_with_shared_columns_comes_near_cheaply_and_is_finished_at_the_exact_searchs_loss_for_less() -> None:
    simulations = np.zeros(2)
    for seed in (3, 6):  # over both: where one search ends far off, the last steps alone may take as many
        exact, cheap = objective(seed), objective(seed)
        wanted, near = solve(exact, secant=True), solve(cheap, cheap=True)
        assert near.rms < 0.2 * near.start_rms
        assert cheap.simulations < exact.simulations / 3
        assert finish(cheap, near.values, 12).rms < 1.01 * wanted.rms
        simulations += cheap.simulations, exact.simulations
    assert simulations[0] < 0.9 * simulations[1]


def test_where_nothing_can_share_a_simulation_cheap_changes_nothing() -> None:
    one, two = objective(), objective()
    for each in (one, two):
        each.acts_on = np.ones((24, 6), bool)  # what a loss on the end effector's pose says
    first, second = solve(one, secant=True, iterations=3), solve(two, secant=True, cheap=True, iterations=3)
    np.testing.assert_array_equal(first.values, second.values)


def test_parameters_that_share_a_joint_are_one_block() -> None:
    assert blocks(objective().acts_on) == [[joint, 6 + joint, 12 + joint, 18 + joint] for joint in range(6)]
    tied = np.array([[True, False, False], [False, True, True], [False, False, True], [True, True, False]])
    assert blocks(tied) == [[0, 1, 2, 3]] and blocks(tied[[0, 2]]) == [[0], [1]]


def test_one_joint_that_cannot_step_does_not_hold_up_the_others() -> None:
    one = objective()
    space = one.simulated.space
    end = solve(one, secant=True).values
    last, others = 17, np.arange(24) % 6 != 5  # the last joint's friction, which sits at a kink; the parameters of the other joints
    start = space.to_unit(end)
    start[others] = np.clip(start[others] + 0.02, 0.0, 1.0)
    rough = one.residuals

    def residuals(values: np.ndarray) -> np.ndarray:
        """As if every move of the last joint made it much worse."""
        left, moved = rough(values), np.abs(space.to_unit(np.atleast_2d(values))[:, last] - start[last])
        rows = left.reshape(len(left), -1, 6)
        rows[:, :, 5] += 10.0 * np.sqrt(moved)[:, None]
        return rows.reshape(left.shape)

    one.residuals = residuals  # type: ignore[method-assign]
    found = finish(one, space.from_unit(start), 8)
    assert found.rms < 1.1 * rms(rough(end))
    assert abs(space.to_unit(found.values)[last] - start[last]) < 1e-6


SCALED = ParameterSpace(
    (
        Parameter("gain", "N m/rad", 1.0, 100.0, 20.0, scale="log"),
        Parameter("friction", "N m", 0.0, 1.0, 0.1),
        Parameter("drag", "N m s^2/rad^2", 0.0, 2.0, 0.3),
    )
)


def test_torques_that_grow_by_one_factor_go_straight_in_their_own_units() -> None:
    values = SCALED.start()
    unit = SCALED.to_unit(values)
    move = SCALED.to_unit(1.01 * values) - SCALED.to_unit(0.99 * values)  # a fiftieth of each value
    half, half_again = SCALED.from_unit(straight(SCALED, unit, np.outer([25.0, 75.0], move)))
    np.testing.assert_allclose(half, 1.5 * values, rtol=1e-3)
    np.testing.assert_allclose(half_again, 2.5 * values, rtol=1e-3)
    np.testing.assert_allclose(SCALED.from_unit(straight(SCALED, unit, 1e4 * move[None])), [[100.0, 1.0, 2.0]])


def rough(flat: float) -> Any:
    """Two parameters, of which almost only the sum shows; each has kinks of its own, as dry friction has."""
    space = ParameterSpace(tuple(Parameter(name, "N m", 0.0, 1.0, 0.5) for name in "ab"))
    rng = np.random.default_rng(0)
    both, apart, phase = rng.normal(size=400), rng.normal(size=400), rng.uniform(0.0, 6.28, (400, 2))

    def residuals(values: np.ndarray) -> np.ndarray:
        a, b = np.atleast_2d(values).T[:, :, None]
        kinks = 3e-4 * (np.sin(2e3 * a + phase[:, 0]) + np.sin(2e3 * b + phase[:, 1]))
        return (a + b - 1.0) * both + flat * (a - b) * apart + kinks

    return SimpleNamespace(simulated=SimpleNamespace(space=space), acts_on=np.ones((2, 1), bool), residuals=residuals, step=STEP)


def test_a_long_difference_along_a_flat_valley_sees_how_flat_it_is() -> None:
    flat, unit, along = 0.01, np.full(2, 0.5), np.array([1.0, -1.0]) / np.sqrt(2.0)
    one = rough(flat)
    singly = jacobian_along_axes(one, unit, np.eye(2))
    again = jacobian_along_axes(one, unit, singly.T @ singly)
    true = np.linalg.norm(jacobian_along_axes(rough(10.0), unit, np.eye(2)) @ along) * flat / 10.0
    off = [abs(np.linalg.norm(slope @ along) / true - 1.0) for slope in (singly, again)]
    assert off[0] > 0.3 and off[1] < 0.2


@pytest.mark.parametrize("apart", [False, True])
def test_differences_along_axes_are_the_jacobian(apart: bool) -> None:
    one = objective()
    space = one.simulated.space
    unit = space.to_unit(space.start())
    base = one.residuals(space.start())[0]
    exact, own = jacobian(one, space, unit, base), nearly(one, space, unit, base) != 0.0
    found = jacobian_along_axes(one, unit, exact.T @ exact + np.eye(len(unit)), apart)
    likeness = [np.corrcoef(exact[own[:, p], p], found[own[:, p], p])[0, 1] for p in range(len(unit))]
    assert np.median(likeness) > 0.95 and min(likeness) > 0.5


def test_the_jacobian_at_the_end_holds_what_joints_do_to_each_other_only_where_that_is_much() -> None:
    one = objective()
    values = solve(one, cheap=True).values
    light = finish(one, values, 2).jacobian
    own = np.repeat(one.acts_on.T[None], len(light) // 6, axis=0).reshape(len(light), -1)
    assert not light[~own].any() and light[own].any()
    heavy, residuals = objective(), Objective.residuals

    def tied(values: np.ndarray) -> np.ndarray:
        """As if each joint's error showed on its neighbour as well."""
        rows = residuals(heavy, values)
        return (rows.reshape(len(rows), -1, 6) @ (np.eye(6) + 0.6 * np.eye(6, k=1))).reshape(len(rows), -1)

    object.__setattr__(heavy, "residuals", tied)
    assert finish(heavy, values, 2).jacobian[~own].any()
