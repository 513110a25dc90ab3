"""Long recordings that are cut into motions where little moves."""

from itertools import pairwise

import numpy as np
import pytest

from benchmarks.blind.cases import robot_of
from edream.core.episode import Episode
from edream.core.errors import EdreamError
from edream.diagnosis.problem import Settings, motions, prepare
from edream.sim.window import at_rest


def strides(seconds: float, name: str = "long") -> Episode:
    """Two joints that rest together for half a second every 5 s, where the measurement's clock is 50 Hz."""
    times = np.arange(0.0, seconds, 0.02)
    within = np.clip((times % 5.0) / 4.5, 0.0, 1.0)
    step = (times // 5.0) + 0.5 * (1.0 - np.cos(np.pi * within))
    position = 0.3 * np.sin(2.0 * np.pi * np.stack([step, 0.5 * step], axis=1))
    return Episode(name, ("pan", "tilt"), times, position, times, position)


def test_pieces_begin_at_rest_and_cover_the_recording_once() -> None:
    episode = strides(60.0)
    pieces = at_rest([episode], 5)
    assert pieces[0].first == 0 and pieces[-1].last == len(episode.times) - 1
    assert all(before.last == after.first for before, after in pairwise(pieces))
    rests = [(episode.times[piece.first] % 5.0) for piece in pieces[1:]]
    assert all(rest >= 4.4 or rest <= 0.1 for rest in rests), "each begins in a rest"
    assert len({piece.episode.name for piece in pieces}) == 5
    assert all(piece.episode.times is episode.times for piece in pieces), "what came before stays known"


def test_a_long_recording_gets_more_pieces_than_a_short_one() -> None:
    lengths = [(w.last - w.first) * 0.02 for w in at_rest([strides(60.0, "a"), strides(20.0, "b")], 8)]
    assert len(lengths) == 8 and min(lengths) > 4.0


def test_one_recording_is_diagnosed_in_pieces_of_which_some_are_never_fitted() -> None:
    robot = robot_of("pan_tilt")
    assert robot is not None
    problem = prepare(robot, [strides(60.0)], Settings())
    proof = {row for window in problem.proof for row in range(window.first + 1, window.last)}
    fitted = {row for window in problem.fitted for row in range(window.first + 1, window.last)}
    assert len(problem.proof) == 2 and len(problem.fitted) == 6
    assert not proof & fitted


def test_a_very_long_recording_is_not_cut_into_more_than_can_be_fitted() -> None:
    made = motions([strides(3000.0)], Settings(until=40.0))
    assert len(made) == 40
    assert max(window.times[-1] for window in made) <= 40.0


def test_a_recording_too_short_to_be_a_motion_is_no_piece() -> None:
    made = motions([strides(20.0, "whole"), strides(0.3, "scrap")], Settings())
    assert len(made) >= 4 and all(window.episode.name.startswith("whole") for window in made)


@pytest.mark.parametrize("lengths", [(10.0,), (5.5, 5.5, 5.5)])
def test_too_little_motion_is_a_sentence(lengths: tuple[float, ...]) -> None:
    with pytest.raises(EdreamError, match=r"at least 4 motions.* into as many of 4 s; the data lasts 1\d\.\d s in all"):
        motions([strides(seconds, f"r{number}") for number, seconds in enumerate(lengths)], Settings())
