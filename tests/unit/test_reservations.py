"""What a fit says against itself."""

import numpy as np
import pytest

from edream.calibration.reservations import reservations
from edream.calibration.worth import Direction, Estimate, Status, Worth


def worth(status: Status, directions: tuple[Direction, ...] = ()) -> Worth:
    estimate = Estimate(1.64, "N m", (0.8, 1.64), status, (), -1.64, 1.64, 0.0)
    return Worth({"constant_torque.torque[joint4]": estimate}, np.eye(1), directions, 0.0)


def error(before: float, after: float) -> dict[str, dict[str, object]]:
    return {"heldout": {"joint_rmse_rad": after, "before": {"joint_rmse_rad": before}}}


def test_a_good_fit_says_nothing() -> None:
    assert reservations(worth("converged"), error(0.01, 0.001), 5) == []


def test_a_number_at_its_bound_is_named_with_what_to_do() -> None:
    (said,) = reservations(worth("at_bound"), error(0.01, 0.001), 5)
    assert said.startswith("constant_torque.torque[joint4] (1.64 N m) stands at the end") and "edream diagnose" in said


def test_a_robot_without_dry_friction_is_believed() -> None:
    none = Estimate(0.0, "N m", (0.0, 0.01), "at_bound", (), 0.0, 2.0, 0.3)
    assert reservations(Worth({"coulomb.torque[joint4]": none}, np.eye(1), (), 0.0), error(0.01, 0.001), 5) == []


@pytest.mark.parametrize(("motions", "counted"), [(1, "1 number from 1 motion may"), (5, "1 number from 5 motions may")])
def test_motions_never_seen_that_got_worse_are_owned_up_to(motions: int, counted: str) -> None:
    (said,) = reservations(worth("converged"), error(0.0026, 0.0041), motions)
    assert "worse than before (0.0026 to 0.0041 rad)" in said and counted in said
    assert reservations(worth("converged"), {"train": error(1, 2)["heldout"]}, motions) == []


def test_what_the_data_leave_open_comes_first() -> None:
    vague = Direction({"a": 1.0}, "The data hardly depend on a; it stays near its prior.")
    assert reservations(worth("at_bound", (vague,)), {}, 3)[0] == vague.sentence
