"""Numbers that recordings hardly tell stay as near to the published ones as they are met as well."""

import numpy as np
import pytest

from benchmarks.blind.cases import robot_of
from edream.core.episode import Episode
from edream.diagnosis.descent import polish
from edream.diagnosis.nuisance import fit_nuisance
from edream.diagnosis.problem import Settings, prepare
from edream.diagnosis.suspects import AS_WELL_MET, most_ordinary
from edream.diagnosis.verdict import off_nominal, strange_numbers
from edream.reality.recorder import Recorder, make_recordings
from edream.reality.truth import draw


def test_one_strange_number_takes_no_others_along_on_a_joint_that_nothing_loads() -> None:
    robot = robot_of("pan_tilt")
    assert robot is not None
    truth = draw(robot, ["viscous"], np.random.default_rng(27), 0.3, ("pan",))
    made = make_recordings(robot, truth, 27, 6, 5.0, Recorder())
    episodes = [Episode(r.name, robot.joints, r.times, r.position, r.command_times, r.command) for r in made]
    problem = prepare(robot, episodes, Settings())
    fit = polish(fit_nuisance(problem))
    assert len(strange_numbers(problem, fit)) > 1, "the valley must have led somewhere"
    home = most_ordinary(problem, fit)
    assert home.rms <= max(AS_WELL_MET * fit.rms, problem.floor)
    assert [(one.name, one.targets) for one in off_nominal(problem, home)] == [("viscous", ("pan",))]
    true = truth.nuisance["kd"]["pan"] + truth.nuisance["damping"]["pan"] + truth.effects[0].values["coefficient"]
    assert home.space.mapping(home.values)["viscous.damping[pan]"] == pytest.approx(true, rel=0.1)
