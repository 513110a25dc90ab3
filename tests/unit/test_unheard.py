"""Where what passes does not stand at the end of its search, effects that first looks passed over are heard."""

from types import SimpleNamespace

import numpy as np
import pytest

from edream.diagnosis import decide, unheard
from edream.diagnosis.candidates import Candidate
from edream.diagnosis.screen import Scored
from edream.diagnosis.trials import Trial


def _trial(effect: str, closed: float) -> Trial:
    fit = SimpleNamespace(name=effect, rms=1.0)
    return Trial(Candidate(effect, ("tilt",)), 0.0, fit, np.full(6, 1.0), closed, True)  # type: ignore[arg-type]


def test_only_what_was_not_tried_is_heard(monkeypatch: pytest.MonkeyPatch) -> None:
    every = [Scored(Candidate(name, ("tilt",)), {}, 0.0) for name in ("backlash", "stribeck", "cogging")]
    monkeypatch.setattr(unheard, "overlooked", lambda problem, fit, scored: every)
    asked: list[str] = []

    def boldly(problem: object, fit: object, errors: object, places: list[Scored], done: object) -> list[Trial]:
        asked.extend(one.candidate.effect for one in places)
        return [_trial("stribeck", 0.5), _trial("cogging", 0.1)]

    monkeypatch.setattr(unheard, "try_boldly", boldly)
    found = unheard.with_unheard(None, None, np.ones(6), [_trial("backlash", 0.4)])  # type: ignore[arg-type]
    assert asked == ["stribeck", "cogging"]
    assert [one.candidate.effect for one in found] == ["stribeck", "backlash", "cogging"]


@pytest.mark.parametrize(("passed", "taken"), [(True, "stribeck"), (False, None)])
def test_they_are_heard_only_where_something_passes_and_nothing_stands(
    monkeypatch: pytest.MonkeyPatch, passed: bool, taken: str | None
) -> None:
    heard: list[int] = []
    told = {
        "with_short_steps": lambda problem, fit: (problem, fit),
        "predicted": lambda problem, fit, taken: np.full(6, 25.0),
        "asks_for_more": lambda problem, fit, first, errors, bare: True,
        "untouched": lambda problem, candidates: frozenset(),
        "screen_twice": lambda problem, fit, done: [],
        "try_best": lambda problem, fit, errors, scored, done: [_trial("backlash", 0.4)],
        "with_confusable": lambda problem, fit, errors, scored, trials, done: trials,
        "settled": lambda problem, fit, errors, trials: trials,
        "restarted": lambda problem, errors, trials: trials,
        "simplified": lambda problem, fit, errors, trials: trials,
        "outdone": lambda problem, fit, errors, trials: None,
        "matters": lambda problem, first, errors, fit, trial, bare: True,
        "passes": lambda problem, trial: passed,
        "first_that_stands": lambda problem, fit, passing: next(
            ((t, t.fit) for t in passing if t.candidate.effect == "stribeck"), (None, fit)
        ),
        "with_unheard": lambda problem, fit, errors, trials, done: heard.append(1) or [_trial("stribeck", 0.5), *trials],
        "narrowed": lambda problem, fit, errors, taken, ended: None,
        "finest": lambda problem, fit, errors, taken, ended, there: (taken, ended),
    }
    for name in ("with_bold", "with_rough"):
        monkeypatch.setattr(decide, name, lambda problem, fit, errors, trials, done: trials)
    for name, stand_in in told.items():
        monkeypatch.setattr(decide, name, stand_in)
    problem = SimpleNamespace(floor=1.0, joints=("tilt",), settings=SimpleNamespace(most=1))
    (only,) = decide.forward(problem, SimpleNamespace(rms=5.0))[2]  # type: ignore[arg-type]
    assert (only.taken.candidate.effect if only.taken else None) == taken
    assert len(heard) == passed
