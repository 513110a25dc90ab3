"""Candidates begun away from the fitted numbers, on made-up ones."""

from types import SimpleNamespace

import numpy as np
import pytest

from edream.diagnosis import nearest
from edream.diagnosis.candidates import Candidate
from edream.diagnosis.screen import Scored


def test_what_leads_after_its_first_steps_goes_on_though_others_were_nearer_before(monkeypatch: pytest.MonkeyPatch) -> None:
    """A dead zone beside published numbers was the sixth nearest of 29, and the first by far after two steps."""
    begun = {f"stand_in_{i}": 1.0 + 0.1 * i for i in range(5)} | {"dead_zone": 1.6} | {f"far_{i}": 3.0 + i for i in range(9)}
    stepped = {name: 0.9 * error for name, error in begun.items()} | {"dead_zone": 0.2}
    gone_on: list[str] = []

    def on(near: SimpleNamespace, fresh: object, most: int) -> SimpleNamespace:
        gone_on.append(near.name)
        return near

    told = {
        "worst_joint": lambda problem, fit: "pan",
        "reaching": lambda problem, fit, group: [Scored(Candidate(name, group), {}, 0.0) for name in begun],
        "by_nearness": lambda problem, fit, places, starts_of: [
            (begun[one.candidate.effect], np.zeros(1), one) for one in sorted(places, key=lambda s: begun[s.candidate.effect])
        ],
        "placement": lambda problem, candidate: candidate,
        "extend": lambda fit, places: (None, None),
        "moving": lambda fit, extended, candidate: None,
        "descend_from": lambda fit, extended, start, candidate, most: SimpleNamespace(
            name=candidate.effect, rms=stepped[candidate.effect], objective=None
        ),
        "descend": on,
    }
    for name, stand_in in told.items():
        monkeypatch.setattr(nearest, name, stand_in)
    problem = SimpleNamespace(settings=SimpleNamespace(threads=1))
    found = nearest.begun_in_all_strengths(problem, None, [("tilt",), ("pan",)], lambda *given: [])  # type: ignore[arg-type]
    assert [one.candidate.effect for _, one in found] == ["dead_zone", "stand_in_0", "stand_in_1", "stand_in_2"] == gone_on
    assert nearest.begun_in_all_strengths(problem, None, [("tilt",)], lambda *given: []) == []  # type: ignore[arg-type]
