"""The motion that is suggested where models cannot be told apart."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
import pytest

from edream.diagnosis import next_motion
from edream.diagnosis.candidates import Candidate
from edream.diagnosis.descent import Fit
from edream.diagnosis.next_motion import as_window, draw, room_of, separations, suggest
from edream.diagnosis.problem import Problem, Settings, prepare
from edream.diagnosis.set_up import other_set_ups
from tests.still_problem import having


def test_the_suggested_motion_stays_inside_the_robots_room_and_separates_better_than_most(problem: Problem, fit: Fit) -> None:
    fits = []
    for effect, quantities in (("actuator_delay", {"time": 0.05}), ("actuator_lag", {"time": 0.05})):
        fits.append(having(problem, fit, Candidate(effect, ("tilt",)), quantities))
    motion = suggest(problem, fits, np.random.default_rng(1))
    assert motion is not None
    room = room_of(problem)
    assert np.all(motion.command >= room.low - 1e-9) and np.all(motion.command <= room.high + 1e-9)
    speed = np.abs(np.diff(motion.command, axis=0)) / np.diff(motion.times)[:, None]
    assert np.all(speed.max(axis=0) <= 1.05 * room.speed)
    others = [draw(room, np.random.default_rng(100 + i)) for i in range(15)]
    apart = separations(problem, fits, [motion.command, *others], {})
    assert apart[0, 0] > np.median(apart[1:])
    assert motion.evidence > 0.0 and as_window(problem, motion.command, {}).times[-1] > 5.0
    assert motion.told == 1 and motion.conditions == ({},)  # at the usual gain


def test_no_motion_is_suggested_between_two_names_of_one_torque(
    problem: Problem, fit: Fit, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They move so nearly alike that what their numbers could make up for, which takes long to simulate, is not asked."""
    monkeypatch.setattr(next_motion, "evidences", lambda *_: pytest.fail("nothing to weigh"))
    fits = []
    friction = fit.space.mapping(fit.values)["coulomb.torque[tilt]"]
    for effect, quantities in (("constant_torque", {"torque": -0.9 * friction}), ("asymmetric_coulomb", {"asymmetry": 0.9})):
        fits.append(having(problem, fit, Candidate(effect, ("tilt",)), quantities))
    assert suggest(problem, fits, np.random.default_rng(1)) is None


def test_half_the_gain_is_suggested_where_no_command_tells_a_pull_from_a_reading(problem: Problem, fit: Fit) -> None:
    read = [replace(w.episode, position=w.episode.position + [0.0, 0.01]) for w in (*problem.fitted, *problem.proof)]
    biased = prepare(problem.robot, read, Settings())
    fit = replace(fit, objective=replace(fit.objective, windows=biased.fitted))
    gain, fits = fit.space.mapping(fit.values)["servo_gain.kp[tilt]"], []
    for effect, quantities in (("constant_torque", {"torque": 0.01 * gain}), ("sensor_bias", {"angle": 0.01})):
        fits.append(having(biased, fit, Candidate(effect, ("tilt",)), quantities))
    motion = suggest(biased, fits, np.random.default_rng(1))
    assert motion is not None and motion.conditions == ({"servo_gain": 0.5},) and motion.told == 1


def test_no_motion_is_suggested_between_two_delays_that_are_one_in_free_motion(problem: Problem, fit: Fit) -> None:
    fits = []
    for effect, time in (("actuator_delay", 0.0300), ("sensor_delay", 0.0305)):  # fits stop near each other, not at one number
        fits.append(having(problem, fit, Candidate(effect, ("tilt",)), {"time": time}))
    assert suggest(problem, fits, np.random.default_rng(1)) is None


def test_a_weight_in_the_hand_is_asked_for_where_that_alone_tells(
    problem: Problem, fit: Fit, monkeypatch: pytest.MonkeyPatch
) -> None:
    simulated: list[Mapping[str, float]] = []

    def told(share: float) -> Callable[..., np.ndarray]:
        def answer(
            problem: Problem, fits: Sequence[Fit], motions: Sequence[np.ndarray], conditions: Mapping[str, float]
        ) -> np.ndarray:
            simulated.append(conditions)
            return np.full((len(motions), 1), share if "hand_weight" in conditions else 0.0)

        return answer

    monkeypatch.setattr(next_motion, "separations", told(10.0 * problem.floor**2))
    monkeypatch.setattr(next_motion, "evidences", told(1e6))
    motion = suggest(problem, [fit, fit], np.random.default_rng(1))
    (held,) = other_set_ups(problem)[1:2]
    assert motion is not None and motion.conditions == (held,) and list(held) == ["hand_weight"]
    assert [one for one in simulated[4:] if one != held] == []  # after a glance at every set-up
