"""Which motions a diagnosis keeps for its proof."""

import numpy as np
import pytest

from edream.core.episode import Episode
from edream.core.errors import EdreamError
from edream.diagnosis.kept_back import drawn, named
from edream.sim.window import Window, whole

BOTH = np.array([True, True])


def motion(number: int, ahead: float = 0.05, pace: float = 1.0) -> Window:
    """Ten seconds of two joints, whose second one follows so far behind its command [rad], or moves at so many times the pace."""
    rng = np.random.default_rng(number)
    times = np.arange(0.0, 10.0, 0.02)
    position = np.stack([0.4 * np.sin(times + rng.uniform(0, 6)), 0.3 * np.sin(pace * times + rng.uniform(0, 6))], axis=1)
    command = position + np.array([0.05, ahead]) * np.cos(times)[:, None]
    return whole([Episode(f"motion_{number:02d}", ("a", "b"), times, position, times, command)])[0]


@pytest.mark.parametrize("hard", [{"ahead": 0.12}, {"pace": 2.0}], ids=["pulled", "fast"])
def test_a_motion_that_asks_more_of_a_joint_than_all_others_is_fitted(hard: dict[str, float]) -> None:
    for number in range(8):
        windows = [motion(one, **(hard if one == number else {})) for one in range(8)]
        for seed in range(6):
            kept = drawn(windows, BOTH, 0.25, seed)
            assert len(kept) == 2 and f"motion_{number:02d}" not in kept
    alike = [motion(one) for one in range(8)]
    assert len({frozenset(drawn(alike, BOTH, 0.25, seed)) for seed in range(6)}) > 1, "all others are drawn by the seed"
    assert drawn(alike, BOTH, 0.25, 3) == drawn(alike[::-1], BOTH, 0.25, 3), "in whatever order they come"


def test_two_that_ask_much_of_a_joint_are_not_both_kept() -> None:
    windows = [motion(one, ahead=0.12 if one in (2, 5) else 0.05) for one in range(8)]
    kept = [drawn(windows, BOTH, 0.25, seed) for seed in range(40)]
    assert not any({"motion_02", "motion_05"} <= one for one in kept)
    assert any({"motion_02", "motion_05"} & one for one in kept), "one may be, since the other shows it"


def test_a_joint_that_does_not_count_says_nothing() -> None:
    windows = [motion(one, ahead=0.12 if one == 0 else 0.05) for one in range(8)]
    assert any("motion_00" in drawn(windows, np.array([True, False]), 0.25, seed) for seed in range(20))


def test_where_every_motion_stands_out_some_are_kept_all_the_same() -> None:
    windows = [motion(one, ahead=0.05 * 1.5**one, pace=2.0 - 0.4 * one) for one in range(4)]
    for share in (0.25, 0.9):
        assert len(drawn(windows, BOTH, share, 0)) == 1, "three at least are fitted"


def test_names_and_patterns() -> None:
    windows = [motion(one) for one in range(5)]
    assert named(windows, ["motion_0[01]"]) == {"motion_00", "motion_01"}
    with pytest.raises(EdreamError, match=r"keeps 3 of 5 motions; expected at least 3"):
        named(windows, ["motion_0[012]"])
    with pytest.raises(EdreamError, match=r"motion for diagnose\.holdout"):
        named(windows, ["lift*"])
