"""Effects on links: where else one that was found is looked for."""

from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.blind.cases import robot_of
from edream.diagnosis import decide, suspects
from edream.diagnosis.candidates import Candidate, next_to
from edream.diagnosis.screen import Scored
from edream.diagnosis.suspects import Suspect, what_stays
from edream.diagnosis.trials import Trial

ARM = robot_of("arm6")


@pytest.mark.parametrize(
    ("link", "near"),
    [("hand", ["wrist_pitch", "jaw"]), ("jaw", ["hand"]), ("shoulder", ["upper_arm"]), ("forearm", ["upper_arm", "wrist_roll"])],
)
def test_the_links_before_and_behind_one(link: str, near: list[str]) -> None:
    assert ARM is not None
    problem = SimpleNamespace(robot=ARM, joints=ARM.joints)
    assert next_to(problem, Candidate("payload", (link,))) == [Candidate("payload", (one,)) for one in near]
    assert next_to(problem, Candidate("spring", ("joint3",))) == []


def test_a_payload_that_is_found_on_a_finger_is_looked_for_in_the_hand(monkeypatch: pytest.MonkeyPatch) -> None:
    """First the upper arm is liked best; the outermost link does better, and the one before that better still."""

    def trial(link: str, closed: float) -> Trial:
        return Trial(Candidate("payload", (link,)), 0.0, SimpleNamespace(rms=1.0), np.zeros(4), closed, True)

    asked: list[str] = []
    ends = {"upper_arm": trial("jaw", 0.94), "jaw": trial("hand", 1.0)}

    def heard(
        problem: object, fit: object, errors: object, scored: object, trials: list[Trial], best: Trial, *rest: object
    ) -> list[Trial]:
        asked.append(best.candidate.targets[0])
        known = rest[0]
        return [ends[asked[-1]]] if known and asked[-1] in ends else []

    monkeypatch.setattr(decide, "heard", heard)
    monkeypatch.setattr(decide, "passes", lambda problem, one: True)
    monkeypatch.setattr(decide, "told_apart", lambda problem, worse, better: True)
    monkeypatch.setattr(decide, "confused_with", lambda problem, effect: [])
    found = decide.with_confusable(SimpleNamespace(), SimpleNamespace(), np.zeros(4), [], [trial("upper_arm", 0.9)])
    assert asked == ["upper_arm", "jaw"]
    assert [one.candidate.targets for one in found] == [("hand",), ("jaw",), ("upper_arm",)]


def test_what_has_been_heard_is_not_heard_again(monkeypatch: pytest.MonkeyPatch) -> None:
    best = Trial(Candidate("payload", ("hand",)), 0.0, SimpleNamespace(rms=1.0), np.zeros(4), 0.9, True)
    begun: list[Candidate] = []
    monkeypatch.setattr(decide, "on_few", lambda problem, fit: fit)
    monkeypatch.setattr(decide, "placed_at", lambda problem, fit, targets, known: [])
    monkeypatch.setattr(decide, "elsewhere", lambda problem, fit, one: [Scored(best.candidate, {}, 0.0)])
    monkeypatch.setattr(decide, "refitted", lambda problem, fit, one, **rest: begun.append(one.candidate))
    monkeypatch.setattr(decide, "rms_among", lambda few, fit: fit.rms)
    known = [SimpleNamespace(name="payload", place="body")]
    problem = SimpleNamespace(settings=SimpleNamespace(threads=1))
    more = decide.heard(problem, SimpleNamespace(rms=2.0), np.zeros(4), [], [best], best, known, lambda n: None)
    assert more == begun == []


def test_what_the_last_one_explains_goes_out_and_that_one_is_fitted_without_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """A payload on jaw and upper arm had been named before the one in the hand was found behind strange numbers."""
    named = [Trial(Candidate("payload", (link,)), 0.0, SimpleNamespace(), np.zeros(4), 0.9, True) for link in ("jaw", "upper_arm")]
    best, other = (Suspect(Candidate("payload", (link,)), SimpleNamespace(name=link), 9.0) for link in ("hand", "wrist_pitch"))
    smaller, first = SimpleNamespace(), np.ones(4)

    def backward(problem: object, fit: object, given: list[Candidate], errors: object) -> tuple[object, list[Candidate]]:
        assert (fit, errors) == (best.fit, first) and [one.targets[0] for one in given] == ["jaw", "upper_arm", "hand"]
        return smaller, given[1:]

    monkeypatch.setattr(suspects, "backward", backward)
    found, stay = what_stays(SimpleNamespace(), named, [best, other], first)
    assert [one.fit for one in found] == [smaller, other.fit] and [one.candidate for one in found] == [
        best.candidate,
        other.candidate,
    ]
    assert stay == named[1:]
