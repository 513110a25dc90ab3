"""Jacobians that share simulations lead to the same place as exact ones, for less."""

import numpy as np

from edream.sim.least_squares import jacobian, nearly, sharing, solve
from edream.sim.objective import Objective, rms
from edream.sim.rollout import whole
from tests.recovery.planted import arm, motions, plant


def objective() -> Objective:
    simulated = arm()
    return Objective(simulated, whole(motions(simulated, plant(simulated, 3), 3, 2, 4.0)), np.arange(7) < 6, stride=2)


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


def test_a_search_with_shared_columns_ends_at_the_exact_searchs_loss_with_a_third_of_its_simulations() -> None:
    exact, cheap = objective(), objective()
    wanted, found = solve(exact, secant=True), solve(cheap, cheap=True)
    assert rms(found.residual) < 1.03 * rms(wanted.residual)
    assert cheap.simulations < exact.simulations / 3


def test_where_nothing_can_share_a_simulation_cheap_changes_nothing() -> None:
    one, two = objective(), objective()
    for each in (one, two):
        each.acts_on = np.ones((24, 6), bool)  # what a loss on the end effector's pose says
    first, second = solve(one, secant=True, iterations=3), solve(two, secant=True, cheap=True, iterations=3)
    np.testing.assert_array_equal(first.values, second.values)
