"""Which candidates are refitted at all, and which are tried boldly, on made-up trials."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from edream.diagnosis import nearest, trials
from edream.diagnosis.candidates import Candidate
from edream.diagnosis.screen import Scored
from edream.diagnosis.trials import with_bold
from tests.still_problem import trial_of


@pytest.mark.parametrize(
    ("small", "far", "closed", "bold"),
    [(False, True, 0.2, True), (False, True, 0.6, False), (True, True, 0.2, False), (False, False, 0.2, False)],
)
def test_larger_models_are_tried_boldly_from_far_off_where_nothing_closes_half(
    monkeypatch: pytest.MonkeyPatch, small: bool, far: bool, closed: float, bold: bool
) -> None:
    found = [trial_of("torque_limit", 0.9), trial_of("spring", 0.1)]
    monkeypatch.setattr(trials, "is_small", lambda fit: small)
    monkeypatch.setattr(trials, "far_off", lambda problem, fit: far)
    monkeypatch.setattr(trials, "overlooked", lambda problem, fit, scored: [])
    monkeypatch.setattr(trials, "try_boldly", lambda *told: found)
    before = [trial_of("spring", closed)]
    after = with_bold(None, None, np.zeros(4), before)
    if bold:
        assert [(t.candidate.effect, t.closed) for t in after] == [
            ("torque_limit", 0.9),
            ("spring", 0.2),
        ]  # the better of the two springs
    else:
        assert after == before


@pytest.mark.parametrize(
    ("gap", "found"),
    [
        (True, {"presliding": 0.6, "spring": 0.9, "payload": 0.6, "integral_action": 0.6, "backlash": 0.4}),
        (False, {"presliding": 0.6, "spring": 0.6, "payload": 0.6, "integral_action": 0.6}),
    ],
)
def test_every_effect_is_tried_boldly_only_where_the_likeliest_leave_a_gap(
    monkeypatch: pytest.MonkeyPatch, gap: bool, found: dict[str, float]
) -> None:
    """The likeliest by the score test and beside the published numbers go over whole motions; of two searches the better counts."""
    bold = [trial_of("spring", 0.9), trial_of("backlash", 0.4)]
    near = [Scored(Candidate("integral_action", ("tilt",)), {}, 0.0)]
    told = {
        "is_small": lambda fit: True,
        "far_off": lambda problem, fit: True,
        "thinned": lambda fit, seconds: fit,
        "overlooked": lambda problem, fit, scored: [],
        "try_boldly": lambda problem, fit, errors, places, done: bold,
        "refit": lambda problem, fit, errors, one: trial_of(one.candidate.effect, 0.6),
        "nearer_beside_published": lambda problem, fit, places: near,
        "leaves_no_gap": lambda problem, fit: not gap and fit.name == "payload",
    }
    for name, stand_in in told.items():
        monkeypatch.setattr(trials, name, stand_in)
    scored = [Scored(Candidate(name, ("tilt",)), {}, 0.5) for name in ("presliding", "spring", "payload", "coulomb")]
    best = trials.try_best(SimpleNamespace(settings=SimpleNamespace(threads=1)), None, np.zeros(4), scored)
    assert {t.candidate.effect: t.closed for t in best} == found
    assert [t.closed for t in best] == sorted(found.values(), reverse=True)


@pytest.mark.parametrize(
    ("closed", "left", "little"), [(0.95, 1.2, True), (0.95, 2.5, False), (0.8, 1.2, False), (0.995, 2.5, True)]
)
def test_little_is_left_where_nearly_all_is_closed_and_no_real_gap_stays_or_all_but_little_is_closed(
    closed: float, left: float, little: bool
) -> None:
    problem, errors = SimpleNamespace(floor=4e-4), np.full(6, (left * 4e-4) ** 2)
    assert trials.leaves_little(problem, replace(trial_of("spring", closed), errors=errors)) is little  # type: ignore[arg-type]


@pytest.mark.parametrize(("left", "heard"), [(1.2, ["spring", "payload"]), (4.0, ["spring", "payload", "coulomb"])])
def test_unlikely_candidates_wait_and_are_not_refitted_where_another_closes_nearly_all(
    monkeypatch: pytest.MonkeyPatch, left: float, heard: list[str]
) -> None:
    floor, asked = 4e-4, []

    def refitted(problem: object, few: object, one: Scored, iterations: int) -> SimpleNamespace:
        asked.append(one.candidate.effect)
        return SimpleNamespace(rms=left * floor if one.candidate.effect == "payload" else 9.0 * floor)

    told = {
        "far_off": lambda problem, fit: False,
        "led_astray": lambda problem, fit: False,
        "groups_off": lambda problem, fit: [],
        "on_few": lambda problem, fit: fit,
        "refitted": refitted,
        "gone_on": lambda fit, near, joints: near,
        "judged": lambda problem, fit, errors, one: trial_of(one.candidate.effect, 1.0 - fit.rms),
    }
    for name, stand_in in told.items():
        monkeypatch.setattr(trials, name, stand_in)
    shares = {"spring": 0.8, "payload": 0.7, "coulomb": 0.2}
    scored = [Scored(Candidate(name, ("tilt",)), {}, share) for name, share in shares.items()]
    problem = SimpleNamespace(settings=SimpleNamespace(threads=1), floor=floor)
    best = trials.try_best(problem, SimpleNamespace(rms=10.0 * floor), np.zeros(4), scored)  # type: ignore[arg-type]
    assert asked == heard and best[0].candidate.effect == "payload"
    # the likeliest by the score test is refitted to its end though its first steps gained little
    assert {t.candidate.effect for t in best} == {"payload", "spring"}


def test_where_servos_at_their_limit_leave_a_joint_off_what_is_nearest_in_some_strength_is_heard_too(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Beside numbers that had made up for a motor of half its torque the score test spoke for a coupling, then a ripple."""
    away = {"torque_limit": 0.5, "spring": 0.7, "coulomb": 0.9, "payload": 2.0}
    stand_ins = {"joint_coupling": 0.21, "stribeck": 0.22, "presliding": 0.23, "backlash": 0.24, "hardening_spring": 0.25}
    ends = {"torque_limit": 0.3, "spring": 0.6, "coulomb": 0.7, "cogging": 0.8, "payload": 0.95, **stand_ins}
    steps: dict[str, object] = {}
    further: list[int] = []

    def fitted(name: str) -> SimpleNamespace:
        return SimpleNamespace(rms=ends[name], unit=np.zeros(1), objective=None)

    def gone_on(fit: object, near: SimpleNamespace, joints: frozenset[str]) -> SimpleNamespace:
        assert joints == {"tilt"}, "the joint's own numbers are differenced anew"
        return near

    places = {
        "worst_joint": lambda problem, fit: "tilt",
        "reaching": lambda problem, fit, group: [Scored(Candidate(name, group), {}, 0.0) for name in away],
        "placement": lambda problem, candidate: candidate,
        "extend": lambda fit, places: (
            SimpleNamespace(residuals=lambda sets: [np.full(4, away[places[0].effect])] * len(sets)),
            None,
        ),
        "descend_from": lambda fit, extended, start, candidate, most: (
            steps.update({candidate.effect: most}) or fitted(candidate.effect)
        ),
        "moving": lambda fit, extended, candidate: None,
        "descend": lambda near, fresh, most: further.append(most) or near,
    }
    told = {
        "far_off": lambda problem, fit: False,
        "led_astray": lambda problem, fit: False,
        "groups_off": lambda problem, fit: [("pan",), ("tilt",)],
        "in_all_strengths": lambda problem, place, extended, absent: [np.zeros(1)],
        "in_all_strengths_beside_published": lambda problem, place, extended, absent: [np.zeros(1), np.ones(1)],
        "on_few": lambda problem, fit: fit,
        "refitted": lambda problem, few, one, iterations: fitted(one.candidate.effect),
        "gone_on": gone_on,
        "judged": lambda problem, fit, errors, one: trial_of(one.candidate.effect, 1.0 - fit.rms),
    }
    for name, stand_in in told.items():
        monkeypatch.setattr(trials, name, stand_in)
    for name, stand_in in places.items():
        monkeypatch.setattr(nearest, name, stand_in)
    problem = SimpleNamespace(floor=0.1, settings=SimpleNamespace(threads=1))
    scored = [Scored(Candidate(name, ("tilt",)), {}, share) for name, share in (("cogging", 0.5), ("spring", 0.45))]
    found = trials.try_best(problem, SimpleNamespace(rms=1.0), np.zeros(4), scored)
    assert [t.candidate.effect for t in found] == ["torque_limit", "spring", "coulomb", "cogging"], "each once, best first"
    assert set(steps) == set(away) and set(steps.values()) == {nearest.FIRST}
    assert set(further) == {nearest.ARRIVING - nearest.FIRST}
    alone = trials.try_best(problem, SimpleNamespace(rms=1.0), np.zeros(4), [])
    assert [t.candidate.effect for t in alone][:3] == ["torque_limit", "spring", "coulomb"], (
        "also where the score test says nothing"
    )
    many = trials.try_best(
        problem, SimpleNamespace(rms=1.0), np.zeros(4), [Scored(Candidate(name, ("tilt",)), {}, 0.5) for name in stand_ins]
    )
    assert [t.candidate.effect for t in many] == [*list(stand_ins)[: trials.FINISHED], "torque_limit", "spring"], (
        "what begins farther away goes to its end, though stand-ins beside numbers that had made up for it are nearer"
    )
