"""Intervals of numbers that go together, in a box."""

import numpy as np
import pytest
from scipy.optimize import minimize

from edream.diagnosis.intervals import SURE, within_box


def test_an_interval_that_no_other_number_stops_is_that_of_the_number_alone() -> None:
    spread = np.array([0.02, 0.05])
    together = np.array([[1.0, 0.9], [0.9, 1.0]])
    low, high = within_box(np.array([0.5, 0.5]), together * np.outer(spread, spread))
    assert low == pytest.approx(0.5 - SURE * spread)
    assert high == pytest.approx(0.5 + SURE * spread)


def test_a_number_that_goes_with_one_at_its_bound_is_known_on_that_side() -> None:
    """Play 0.17 +- 0.14 in the box, along a valley in which the servo's side of the gear leaves the box soon."""
    spread = np.array([0.14, 0.8])
    covariance = np.array([[1.0, 0.95], [0.95, 1.0]]) * np.outer(spread, spread)
    low, high = within_box(np.array([0.17, 0.2]), covariance)
    assert 0.17 - SURE * spread[0] < 0.0 < low[0]
    assert 0.17 < high[0] < 0.17 + SURE * spread[0]  # there the other one would have to go to 1.69
    assert (low[1], high[1]) == (0.0, 1.0)


@pytest.mark.parametrize("seed", range(6))
def test_the_ends_are_those_that_a_search_finds_in_ellipsoid_and_box(seed: int) -> None:
    rng = np.random.default_rng(seed)
    unit, root = rng.uniform(0.05, 0.95, 4), 0.12 * rng.normal(size=(4, 4))
    covariance = root @ root.T + 1e-5 * np.eye(4)
    known = np.linalg.inv(covariance)
    inside = {"type": "ineq", "fun": lambda x: SURE**2 - (x - unit) @ known @ (x - unit)}
    low, high = within_box(unit, covariance)
    for number in range(4):
        for side, end in ((1.0, low), (-1.0, high)):
            found = minimize(lambda x, n=number, s=side: s * x[n], unit, bounds=[(0.0, 1.0)] * 4, constraints=inside)
            assert end[number] == pytest.approx(found.x[number], abs=3e-4)


def test_numbers_of_which_nothing_is_known_stay_where_they_are() -> None:
    low, high = within_box(np.array([0.3, 0.6]), np.diag([0.0, 0.01]))
    assert (low[0], high[0]) == (0.3, 0.3)
    assert (low[1], high[1]) == pytest.approx((0.6 - 0.196, 0.6 + 0.196))
