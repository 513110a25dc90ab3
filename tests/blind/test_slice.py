"""A slice of the blind tests: short sessions with the smallest robot. `make blind` runs them all."""

from pathlib import Path
from typing import Any

import pytest

from benchmarks.blind.cases import Case, Session, robot_of
from benchmarks.blind.runner import run_case, scored

SHORT = Session(motions=8, seconds=5.0)


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("blind")


def outcome(case: Case, folder: Path) -> dict[str, Any]:
    robot = robot_of(case.robot)
    assert robot is not None
    result = run_case(case, robot, folder, SHORT)
    assert "failed" not in result, result
    return scored(case, robot, folder, SHORT, result)


SLOW = [pytest.param(name, marks=pytest.mark.slow) for name in ("payload", "actuator_delay")]


@pytest.mark.parametrize("effect", ["stribeck", "viscous", *SLOW])
def test_a_hidden_effect_is_named_at_its_place_and_nothing_else(effect: str, folder: Path) -> None:
    row = outcome(Case("pan_tilt", (effect,), 0, "single"), folder)
    assert row["found"] != ["missed"], row
    assert not row["extra"], row
    assert row["right"], row


def test_nothing_is_named_where_nothing_is_hidden(folder: Path) -> None:
    row = outcome(Case("pan_tilt", (), 0, "none"), folder)
    assert row["verdict"] == "none", row
    assert not row["named"], row


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_an_effect_outside_the_library_is_unnamed_and_its_gap_reduced(folder: Path) -> None:
    row = outcome(Case("pan_tilt", ("cable_snag",), 0, "foreign"), folder)
    assert row["verdict"] == "unnamed", row
    assert row["gap"]["after_rad"] < row["gap"]["before_rad"], row
