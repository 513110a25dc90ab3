"""A policy's line of the table."""

from types import SimpleNamespace
from typing import Any

import pyarrow as pa
import pytest

from edream.stages.evaluate import row_of


def test_a_thing_that_fell_far_away_does_not_say_how_near_others_came() -> None:
    about: Any = SimpleNamespace(cameras=())
    outcomes = pa.table({"success": [True, True, False], "grasped": [True, True, None], "distance": [0.01, 0.02, 300.0]})
    row = row_of("sft", about, outcomes)
    assert row["distance_m"] == pytest.approx(0.02)
    assert row["success"].share == pytest.approx(2 / 3) and row["grasp"].trials == 2
