"""Which effects go out again once later ones are beside them."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from edream.diagnosis import backward as steps
from edream.diagnosis import left_out, verdict
from edream.diagnosis.candidates import Candidate
from edream.diagnosis.decide import Round
from edream.diagnosis.trials import Trial

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


@pytest.mark.parametrize(("standing", "stayed"), [({"load_friction", "payload"}, 2), ({"load_friction"}, 1), (set(), 1)])
def test_what_no_longer_stands_once_others_went_out_goes_out_too(
    monkeypatch: pytest.MonkeyPatch, standing: set[str], stayed: int
) -> None:
    """A delay was named beside a ripple; without that its interval held none, and it was still named."""
    fit = SimpleNamespace(ended=True)
    monkeypatch.setattr(steps, "stands", lambda problem, candidate, fit: candidate.effect in standing)
    monkeypatch.setattr(steps, "refitted_without", lambda problem, fit, candidate: SimpleNamespace(ended=False, gone=candidate))
    monkeypatch.setattr(steps, "polish", lambda fit: fit)
    ended, kept = steps.still_standing(SimpleNamespace(), fit, [FRICTION, PAYLOAD])  # type: ignore[arg-type]
    assert kept == [FRICTION, PAYLOAD][:stayed]
    assert ended is fit if stayed > 1 else ended.gone is PAYLOAD  # type: ignore[attr-defined]


@pytest.mark.parametrize("gone", [True, False])
def test_what_is_left_alone_has_the_first_rounds_candidates_for_rivals(monkeypatch: pytest.MonkeyPatch, gone: bool) -> None:
    """A gear was named without a doubt that had stood beside a coupling; alone it does no better than a payload."""

    def trial(effect: str, closed: float) -> Trial:
        return Trial(Candidate(effect, ("tilt",)), 0.1, SimpleNamespace(name=effect), np.zeros(4), closed, True)

    coupling, payload, gear = trial("joint_coupling", 0.8), trial("payload", 0.7), trial("gear_ratio", 0.2)
    first = Round(SimpleNamespace(), np.ones(4), [], [coupling, payload], coupling)
    second = Round(SimpleNamespace(), np.ones(4), [], [gear], gear)
    stayed = [gear] if gone else [coupling, gear]
    monkeypatch.setattr(verdict, "judged", lambda problem, fit, errors, one: replace(one, closed=0.75, fit=fit))
    trials, heard = verdict.left_alone(SimpleNamespace(), SimpleNamespace(name="ended"), [first, second], stayed)
    if not gone:
        assert (trials, heard) == (stayed, [first, second])
        return
    assert [(t.candidate.effect, t.closed, t.fit.name) for t in trials] == [("gear_ratio", 0.75, "ended")]
    assert [(one.taken, [t.candidate.effect for t in one.trials]) for one in heard] == [
        (trials[0], ["joint_coupling", "gear_ratio", "payload"])
    ]


@pytest.mark.parametrize(
    ("left", "end", "moves"), [((0.4, 0.02), 0.01, True), ((0.4, 0.02), 0.99, False), ((0.96, 1.2), 0.5, False), ((), 0.5, False)]
)
def test_a_fit_leaves_a_valley_that_candidates_show_to_be_false(
    monkeypatch: pytest.MonkeyPatch, left: tuple[float, ...], end: float, moves: bool
) -> None:
    """On arms driven by torques every candidate closed 99 % of a gap, and none of it was its own: they had only begun elsewhere."""
    bare = {number: SimpleNamespace(rms=error) for number, error in enumerate(left)}
    trials = [SimpleNamespace(fit=number, candidate=PAYLOAD) for number in bare]
    monkeypatch.setattr(steps, "without", lambda fit, candidate: bare[fit])
    monkeypatch.setattr(steps, "descend", lambda fit, fresh, most: SimpleNamespace(rms=end, begun=fit))
    found = steps.nearer_without(SimpleNamespace(rms=1.0), trials)  # type: ignore[arg-type]
    assert found == (SimpleNamespace(rms=end, begun=bare[1]) if moves else None)


@pytest.mark.parametrize("standing", [True, False])
def test_a_name_whose_interval_holds_none_beside_a_later_one_goes_out(monkeypatch: pytest.MonkeyPatch, standing: bool) -> None:
    """Friction by place of -0.06 to 3 N m had been named of a wrist whose dry friction it stood in for, beside what was hidden."""
    taken = [Trial(one, 0.1, SimpleNamespace(), np.zeros(4), 0.8, True) for one in (PAYLOAD, FRICTION)]
    rounds = [Round(SimpleNamespace(), np.ones(4), [], [one], one) for one in taken]
    monkeypatch.setattr(verdict, "backward", lambda problem, fit, named, first: ("both", list(named)))
    monkeypatch.setattr(verdict, "stands", lambda problem, candidate, fit: standing or candidate != PAYLOAD)
    monkeypatch.setattr(verdict, "still_standing", lambda problem, fit, kept: ("friction alone", [FRICTION]))
    monkeypatch.setattr(verdict, "with_plain", lambda problem, fit, kept: fit)
    monkeypatch.setattr(verdict, "left_alone", lambda problem, fit, rounds, trials: (trials, rounds))
    monkeypatch.setattr(verdict, "predicted", lambda problem, fit, last: np.full(4, 0.5))
    monkeypatch.setattr(verdict, "falls_short", lambda problem, first, left: False)
    found = verdict.what_stands(SimpleNamespace(), "before", "ended", rounds)  # type: ignore[arg-type]
    assert found.fit == ("both" if standing else "friction alone")
    assert [one.candidate for one in found.trials] == ([PAYLOAD, FRICTION] if standing else [FRICTION])
