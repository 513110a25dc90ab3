"""What several tests of the diagnosis look at."""

import pytest

from edream.diagnosis.descent import Fit
from edream.diagnosis.problem import Problem
from tests.still_problem import fit_of, still_problem


@pytest.fixture(scope="module")
def problem() -> Problem:
    """Recordings in which nothing is hidden."""
    return still_problem()


@pytest.fixture(scope="module")
def fit(problem: Problem) -> Fit:
    """The usual numbers, as published."""
    return fit_of(problem)
