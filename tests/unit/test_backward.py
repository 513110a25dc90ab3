"""Which effects go out again once later ones are beside them."""

from types import SimpleNamespace

import numpy as np
import pytest

from edream.diagnosis import backward as steps
from edream.diagnosis import left_out
from edream.diagnosis.candidates import Candidate

PAYLOAD, FRICTION = Candidate("payload", ("forearm",)), Candidate("load_friction", ("lift",))


@pytest.mark.parametrize(
    ("without", "elsewhere", "kept"),
    [
        (1.3**2, 0.0, False),  # a twentieth of the first gap of nine floors is 0.45, and 0.2 are gained
        (1.3**2, 0.3, True),  # by a joint on which nothing else is named
        (3.0**2, 0.0, True),
        (1.1**2, 0.0, False),  # next to nothing
    ],
)
def test_an_earlier_effect_must_gain_what_is_asked_of_a_later_one(
    monkeypatch: pytest.MonkeyPatch, without: float, elsewhere: float, kept: bool
) -> None:
    """A payload was named for friction with the load, and stayed beside it, though its mass might be nothing."""
    left = {"both": 1.1**2, "friction alone": without}
    bare: list[frozenset[str]] = []
    monkeypatch.setattr(steps, "left_out_errors", lambda problem, fit: np.full(6, left[fit]))
    monkeypatch.setattr(steps, "refitted_without", lambda problem, fit, candidate: "friction alone")
    monkeypatch.setattr(left_out, "gained_on", lambda problem, joints, before, after: bare.append(joints) or elsewhere)
    problem = SimpleNamespace(floor=1.0, joints=("lift", "pan"), settings=SimpleNamespace(seed=0, gain=0.1))
    fit, names = steps.backward(problem, "both", [PAYLOAD, FRICTION], np.full(6, 10.0**2))  # type: ignore[arg-type]
    assert (fit, names) == (("both", [PAYLOAD, FRICTION]) if kept else ("friction alone", [FRICTION]))
    assert set(bare) <= {frozenset({"pan"})}
