"""The servo's share of a joint's damping, which only motions that reach the limit of its torque tell."""

from pathlib import Path

import numpy as np
import pytest

import edream
from edream.core.episode import Episode
from edream.diagnosis.descent import polish
from edream.diagnosis.nuisance import fit_nuisance, with_shares
from edream.diagnosis.problem import Problem, Settings, prepare
from edream.reality.recorder import Recorder, make_recordings
from edream.reality.truth import Truth, draw
from edream.sim.robot import load_robot


def recorded(path: Path, seed: int) -> tuple[Problem, Truth]:
    robot = load_robot(path)
    truth = draw(robot, [], np.random.default_rng(seed), 0.3, ("pan", "tilt"))
    made = make_recordings(robot, truth, seed, 6, 5.0, Recorder())
    episodes = [Episode(r.name, robot.joints, r.times, r.position, r.command_times, r.command) for r in made]
    return prepare(robot, episodes, Settings()), truth


def weak(folder: Path, limit: float) -> Path:
    """A pan-tilt head whose servos give no more than so many N m, and damp about as much as the joints do."""
    text = (Path(edream.__file__).parent / "robots" / "pan_tilt.xml").read_text()
    assert text.count('forcerange="-5 5"') == 2 and text.count('kv="0.5"') == 2
    path = folder / "weak.xml"
    path.write_text(text.replace('forcerange="-5 5"', f'forcerange="-{limit} {limit}"'))
    return path


def test_motions_that_reach_a_limit_tell_the_share_and_it_becomes_true(tmp_path: Path) -> None:
    problem, truth = recorded(weak(tmp_path, 0.5), 4)
    usual = fit_nuisance(problem)
    shared, fit = with_shares(problem, usual)
    assert shared.shared, "the motions must reach the limit"
    assert fit.rms <= usual.rms
    fit = polish(fit)
    found, intervals = fit.space.mapping(fit.values), fit.intervals()
    for (joint,) in shared.shared:
        servo, bare = truth.nuisance["kd"][joint], truth.nuisance["damping"][joint]
        low, high = intervals[f"viscous.inside[{joint}]"]
        assert found[f"viscous.inside[{joint}]"] == pytest.approx(servo / (servo + bare), abs=max(0.05, high - low))


def test_motions_below_the_limit_leave_the_share_as_published(tmp_path: Path) -> None:
    problem, _ = recorded(weak(tmp_path, 50.0), 4)
    usual = fit_nuisance(problem)
    same, fit = with_shares(problem, usual)
    assert same is problem and fit is usual
