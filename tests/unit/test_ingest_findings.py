"""Ingest notices what is odd in an episode and says so."""

from dataclasses import replace

import numpy as np
import pytest

from edream.core.episode import Episode, Video
from edream.ingest.findings import find, quantum, shifts, summarise

JOINTS = ("a", "b")


def episode(lag: float = 0.06, seed: int = 0) -> Episode:
    rng = np.random.default_rng(seed)
    times = np.arange(800) * 0.01
    centres = np.sort(rng.uniform(0, 8, (2, 6)))
    heights = rng.normal(size=(2, 6))

    def motion(t: np.ndarray) -> np.ndarray:
        return (heights.T * np.tanh((t[:, None, None] - centres.T) / 0.1)).sum(axis=1)

    return Episode("wave", JOINTS, times, 0.3 * motion(times - lag), times, 0.3 * motion(times))


def test_the_shift_between_command_and_measurement_is_found() -> None:
    for lag in (0.02, 0.06, 0.13):
        assert list(shifts(episode(lag)).values()) == pytest.approx([lag, lag], abs=0.004)


def test_the_encoder_step_is_found_and_nothing_is_found_without_one() -> None:
    smooth = episode().position[:, 0]
    step = 2 * np.pi / 4096
    assert quantum((np.round(smooth / step) * step).astype(np.float32).astype(float)) == pytest.approx(step, rel=1e-3)
    assert quantum(smooth) is None
    assert quantum(np.zeros(50)) is None


def test_gaps_and_rate_are_found() -> None:
    whole = episode()
    keep = np.ones(800, bool)
    keep[300:320] = False
    found = find(replace(whole, times=whole.times[keep], position=whole.position[keep]))
    assert found.rate == pytest.approx(100.0) and found.gaps == ((pytest.approx(2.99), pytest.approx(0.21)),)
    assert "1 gaps; the longest lasts 210 ms" in " ".join(found.sentences())


def test_a_dead_joint_is_named() -> None:
    whole = episode()
    position = whole.position.copy()
    position[:, 1] = 0.2
    assert find(replace(whole, position=position)).dead == ("b",)


def test_degrees_beside_radians_are_noticed() -> None:
    whole = episode()
    found = find(replace(whole, command=np.rad2deg(whole.command)))
    assert len(found.units) == 2 and "degrees beside radians" in found.units[0]
    assert find(whole).units == ()


def test_a_dummy_target_is_noticed() -> None:
    whole = episode()
    command = whole.command.copy()
    command[:, 0] = 20.0
    assert any("dummy target" in said and "'a'" in said for said in find(replace(whole, command=command)).units)


def test_values_outside_the_joint_range_are_noticed() -> None:
    said = find(episode(), {"a": (-0.01, 0.01)}).units
    assert len(said) == 1 and "lie outside its range" in said[0]


def test_unsigned_effort_is_noticed() -> None:
    whole = episode()
    assert find(replace(whole, effort=np.abs(whole.position))).unsigned_effort
    assert not find(replace(whole, effort=whole.position)).unsigned_effort


def test_time_without_torque_is_summed() -> None:
    whole = episode()
    enabled = np.ones(800, bool)
    enabled[200:400] = False
    assert find(replace(whole, enabled=enabled)).torque_off == pytest.approx(2.0)


def test_the_colour_preview_shows_both_orders() -> None:
    import cv2

    whole = episode()
    red = np.zeros((20, 30, 3), np.uint8)
    red[..., 0] = 200
    found = find(replace(whole, videos={"front": Video(whole.times, 20, 30, lambda: iter([red]))}))
    image = cv2.imdecode(np.frombuffer(found.previews["front"], np.uint8), cv2.IMREAD_COLOR)[:, :, ::-1]
    assert image.shape == (20, 60, 3)
    assert image[0, 0].tolist() == [200, 0, 0] and image[0, 59].tolist() == [0, 0, 200]


def test_what_differs_by_its_numbers_alone_is_said_once() -> None:
    some = [episode(seed=seed) for seed in range(3)]
    found = [find(replace(one, position=one.position * 60.0, command=one.command * 60.0)) for one in some]
    said = [sentence for sentence in summarise(found) if "its position reaches" in sentence]
    assert len(said) == 2 and all("(3 of 3 episodes, such as this)" in sentence for sentence in said)
    assert "'a'" in said[0] and "'b'" in said[1]


def test_a_data_set_is_summed_up() -> None:
    said = summarise([find(episode(0.06, seed)) for seed in range(3)])
    assert said[0].startswith("3 episodes at 100.00 to 100.00 Hz")
    assert any("follows command by 60 ms on all joints" in one for one in said)


def test_a_recording_that_is_mostly_one_gap_tells_no_shift_and_takes_no_memory() -> None:
    whole = episode()
    late = whole.times.copy()
    late[-1] += 1e9
    assert shifts(replace(whole, times=late)) == {}
