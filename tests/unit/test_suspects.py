"""Which effects are heard behind strange numbers, on made-up fits."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest

from edream.diagnosis import suspects
from edream.diagnosis.candidates import Candidate
from edream.diagnosis.screen import Scored
from edream.diagnosis.trials import Trial

STRANGE = ["coulomb.torque[lift]"]
RELIEF = {"directional_efficiency": 30.0, "load_friction": 40.0, "spring": 1.0}


@dataclass(frozen=True)
class FitOf:
    """A fit of one effect."""

    effect: str


@pytest.mark.parametrize("scored", [["directional_efficiency", "spring"], ["directional_efficiency", "load_friction", "spring"]])
def test_a_twin_of_the_best_effect_behind_strange_numbers_is_heard_once(monkeypatch: pytest.MonkeyPatch, scored: list[str]) -> None:
    """The score test may pass it over: friction with the load beside an efficiency that it is a special case of."""
    heard = []

    def refit(problem: object, believing: object, errors: np.ndarray, one: Scored) -> Trial:
        heard.append(one.candidate.effect)
        return Trial(one.candidate, 0.1, FitOf(one.candidate.effect), np.ones(4), 0.0, True)

    def placed_at(problem: object, fit: object, targets: tuple[str, ...], effects: list[str]) -> list[Scored]:
        return [Scored(Candidate(name, targets), {}, 0.0) for name in effects]

    told = {
        "believe_published": lambda problem, fit: FitOf("none"),
        "strangeness": lambda fit, names: 50.0 if fit.effect == "none" else 1.0,
        "left_out_errors": lambda problem, fit: np.ones(4),
        "screen": lambda problem, fit, done: [Scored(Candidate(name, ("lift",)), {}, 0.1) for name in scored],
        "refit": refit,
        "relief_by": lambda believing, fit: RELIEF[fit.effect],
        "descend": lambda fit, fresh, steps: fit,
        "judged": lambda problem, fit, errors, trial: trial,
        "confused_with": lambda problem, effect: ["load_friction"] if effect == "directional_efficiency" else [],
        "placed_at": placed_at,
    }
    for name, stand_in in told.items():
        monkeypatch.setattr(suspects, name, stand_in)
    problem = SimpleNamespace(settings=SimpleNamespace(threads=1))
    found = suspects.find_suspects(problem, FitOf("none"), STRANGE)
    if "load_friction" in scored:  # then it is the best itself, and no twin of its own is known here
        assert heard == scored
    else:
        assert heard == [*scored, "load_friction"]
    assert [(s.candidate.effect, s.relief) for s in found] == [("load_friction", 40.0), ("directional_efficiency", 30.0)]
