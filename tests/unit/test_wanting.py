"""What is looked for where no candidate closes half of a real gap."""

from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.blind.cases import robot_of
from edream.diagnosis import wanting
from edream.diagnosis.candidates import Candidate
from edream.diagnosis.left_out import leaves_no_gap, left_out_errors
from edream.diagnosis.nuisance import fit_nuisance
from edream.diagnosis.problem import Settings, prepare
from edream.diagnosis.trials import Trial
from edream.reality.truth import draw
from tests.stand_in import episodes_of


@pytest.mark.parametrize(
    ("gap", "closed", "passing", "is_asked"),
    [(3.0, 0.4, True, True), (3.0, 0.6, True, False), (3.0, 0.9, False, True), (1.5, 0.0, False, False), (3.0, 0.0, False, True)],
)
def test_it_is_asked_for_where_nothing_that_passes_closes_half_of_a_real_gap(
    monkeypatch: pytest.MonkeyPatch, gap: float, closed: float, passing: bool, is_asked: bool
) -> None:
    monkeypatch.setattr(wanting, "passes", lambda problem, trial: passing)
    errors = np.full(6, gap**2)
    left = errors - closed * (errors - 1.0)
    trials = [Trial(Candidate("spring", ("pan",)), 0.1, SimpleNamespace(), left, closed, True)] if closed else []
    # of three floors, 0.4 leaves 2.4, which is real, and 0.6 leaves 2.05, which is, too, but closes more than half
    assert wanting.is_wanting(SimpleNamespace(floor=1.0), errors, trials) is is_asked


def test_a_dead_zone_is_found_behind_the_dry_friction_that_has_made_up_for_it() -> None:
    robot = robot_of("pan_tilt")
    assert robot is not None
    truth = draw(robot, ["dead_zone"], np.random.default_rng(0))
    episodes = episodes_of(robot, truth, 0)
    problem = prepare(robot, episodes, Settings(effects=("dead_zone", "stribeck", "position_friction", "encoder_offset")))
    usual = fit_nuisance(problem)
    rivals = wanting.with_put_back(problem, usual, left_out_errors(problem, usual), [])
    assert rivals[0].candidate == Candidate("dead_zone", truth.effects[0].targets)
    assert rivals[0].closed > 0.9
    assert leaves_no_gap(problem, rivals[0].fit)
