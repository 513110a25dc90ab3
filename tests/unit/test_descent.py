"""The end of a descent, where intervals are true."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import edream
from edream.diagnosis.candidates import Candidate, placement
from edream.diagnosis.descent import begin, cost, descend, polish, with_true_slopes
from edream.diagnosis.nuisance import fit_nuisance
from edream.diagnosis.problem import Settings, prepare
from edream.diagnosis.screen import extend, with_quantities
from edream.reality.truth import draw
from edream.sim.differences import straight
from edream.sim.robot import load_robot
from tests.stand_in import episodes_of

HEAD = load_robot(Path(edream.__file__).parent / "robots" / "pan_tilt.xml", site="ee")


@pytest.mark.parametrize("seed", [0, 3])
def test_a_standard_deviation_along_the_flattest_valley_costs_one_and_the_truth_is_within_the_interval(seed: int) -> None:
    """All torques of pan may be larger by one factor: first differences along single numbers mistake how flat that is."""
    truth = draw(HEAD, ("stribeck",), np.random.default_rng(seed), 0.3, ("pan",))
    problem = prepare(HEAD, episodes_of(HEAD, truth, 4, 8, 6.0), Settings())
    friction = placement(problem, Candidate("stribeck", ("pan",)))
    extended, absent = extend(fit_nuisance(problem), [friction])
    start = with_quantities(extended, absent, [friction], [{"torque": 0.2, "speed": 0.15}])
    fit = with_true_slopes(polish(descend(begin(extended, np.clip(extended.simulated.space.to_unit(start), 0.0, 1.0)), None, 12)))
    curvature, axes = np.linalg.eigh(fit.hessian())
    away = axes[:, 0] / np.sqrt(curvature[0])
    units = straight(fit.space, fit.unit, np.array([away, -away]))
    residuals = fit.objective.residuals(fit.space.from_unit(units))
    rises = [cost(replace(fit, unit=u, residual=r)) - cost(fit) for u, r in zip(units, residuals, strict=True)]
    assert sum(rises) / 2 == pytest.approx(1.0, abs=0.5)  # that of one side, and of the other: the fit may stand on a slope
    low, high = fit.intervals()["stribeck.torque[pan]"]
    assert low < truth.effects[0].values["torque"] < high
