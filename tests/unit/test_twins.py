"""Twins of the best candidate, none of which goes unheard."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from edream.diagnosis import candidates, decide
from edream.diagnosis.candidates import Candidate, placement
from edream.diagnosis.nearest import as_much_as
from edream.diagnosis.screen import Scored, extend
from edream.diagnosis.starts import in_all_strengths
from edream.diagnosis.trials import Trial
from tests.still_problem import fit_of, having, still_problem, trial_of


def _refits_to(monkeypatch: pytest.MonkeyPatch, end: Trial) -> None:
    """Every candidate can be placed, and its refit ends where `end` does."""
    told = {
        "on_few": lambda problem, fit: fit,
        "without": lambda fit, candidate: fit,
        "at_numbers_of": lambda few, fit: few,
        "leaves_no_gap": lambda problem, fit: False,
        "placed_at": lambda problem, fit, targets, known: [Scored(Candidate(e.name, targets), {}, 0.0) for e in known],
        "elsewhere": lambda problem, fit, best: [],
        "refitted": lambda problem, fit, one, iterations, joints: SimpleNamespace(rms=1.0, objective=None),
        "from_nearest": lambda problem, fit, one, starts_of, iterations: SimpleNamespace(rms=1.0),
        "fresh_columns": lambda fit, objective: np.ones(1, bool),
        "of_joints": lambda objective, joints: np.ones(1, bool),
        "descend": lambda fit, fresh, iterations: fit,
        "rms_among": lambda few, fit: fit.rms,
        "gone_on": lambda fit, begun, joints: begun,
        "judged": lambda problem, fit, errors, one: replace(end, candidate=one.candidate),
    }
    for name, stand_in in told.items():
        monkeypatch.setattr(decide, name, stand_in)


@pytest.mark.parametrize(("tried", "closed", "heard"), [("pan", 0.1, ["tilt"]), ("tilt", 0.1, ["tilt"]), ("tilt", 0.85, [])])
def test_what_the_best_one_is_confused_with_is_heard_where_that_one_acts(
    monkeypatch: pytest.MonkeyPatch, tried: str, closed: float, heard: list[str]
) -> None:
    """What was tried where the score test liked it says nothing of this joint; what came to little here needs more patience."""
    fit = SimpleNamespace(rms=2.0)
    best = replace(trial_of("torque_speed_limit", 0.9), fit=SimpleNamespace(rms=1.0))
    drag = replace(trial_of("quadratic_drag", closed), candidate=Candidate("quadratic_drag", (tried,)))
    effects = [SimpleNamespace(name=name, confusable=(), place="joint") for name in ("quadratic_drag", "payload")]
    monkeypatch.setattr(candidates, "library", lambda problem: effects)
    monkeypatch.setattr(decide, "passes", lambda problem, t: t.closed > 0.5)
    monkeypatch.setattr(decide, "told_apart", lambda problem, worse, better: True)
    _refits_to(monkeypatch, replace(best, closed=0.8))
    scored = [Scored(Candidate("quadratic_drag", ("pan",)), {}, 0.2), Scored(Candidate("payload", ("head",)), {}, 0.1)]
    problem = SimpleNamespace(settings=SimpleNamespace(threads=1))
    found = decide.with_confusable(problem, fit, np.zeros(4), scored, [best, drag])
    assert [t.candidate.targets[0] for t in found if t not in (best, drag)] == heard
    assert {t.candidate.effect for t in found} == {"torque_speed_limit", "quadratic_drag"}


@pytest.mark.parametrize(("told", "heard"), [(False, ["load_friction", "presliding"]), (True, [])])
def test_twins_of_what_cannot_be_told_from_the_best_are_heard_too(
    monkeypatch: pytest.MonkeyPatch, told: bool, heard: list[str]
) -> None:
    """A spring may be an efficiency, whose twin is friction with the load, which has another; no twin is asked twice."""
    fit = SimpleNamespace(rms=2.0)
    both = trial_of("spring", 0.9), trial_of("directional_efficiency", 0.8)
    best, rival = (replace(one, fit=SimpleNamespace(rms=1.0)) for one in both)
    friction, sliding, far = (SimpleNamespace(name=name, place="joint") for name in ("load_friction", "presliding", "coulomb"))
    known = {"spring": [], "directional_efficiency": [friction], "load_friction": [friction, sliding], "presliding": [far]}
    monkeypatch.setattr(decide, "confused_with", lambda problem, effect: known[effect])
    monkeypatch.setattr(decide, "passes", lambda problem, trial: True)
    monkeypatch.setattr(decide, "told_apart", lambda problem, worse, better: told)
    _refits_to(monkeypatch, replace(best, closed=0.85))
    problem = SimpleNamespace(settings=SimpleNamespace(threads=1))
    found = decide.with_confusable(problem, fit, np.zeros(4), [], [best, rival])
    assert [t.candidate.effect for t in found if t not in (best, rival)] == heard


@pytest.mark.parametrize(("best_there", "heard"), [(1.0, []), (1.9, ["spring"])])
def test_a_twin_is_measured_against_what_the_best_one_does_on_the_same_few_motions(
    monkeypatch: pytest.MonkeyPatch, best_there: float, heard: list[str]
) -> None:
    """It leaves 1.8 of 2 there, a quarter of the best one's gain, or twice that; on all motions the best one leaves 1."""
    best = replace(trial_of("gear_ratio", 0.9), fit=SimpleNamespace(rms=1.0))
    monkeypatch.setattr(decide, "confused_with", lambda problem, effect: [SimpleNamespace(name="spring", place="joint")])
    monkeypatch.setattr(decide, "passes", lambda problem, t: t is best)
    monkeypatch.setattr(decide, "told_apart", lambda problem, worse, better: True)
    _refits_to(monkeypatch, best)
    monkeypatch.setattr(decide, "refitted", lambda *args, **options: SimpleNamespace(rms=1.8, objective=None))
    monkeypatch.setattr(decide, "from_nearest", lambda *args: SimpleNamespace(rms=1.8))
    monkeypatch.setattr(decide, "rms_among", lambda few, fit: best_there)
    problem = SimpleNamespace(settings=SimpleNamespace(threads=1))
    scored = [Scored(Candidate("spring", ("pan",)), {}, 0.1)]
    found = decide.with_confusable(problem, SimpleNamespace(rms=2.0), np.zeros(4), scored, [best])
    assert [t.candidate.effect for t in found if t is not best] == heard


@pytest.mark.parametrize(("closes", "begun"), [(True, ["found"]), (False, ["found", "fitted"])])
def test_a_twin_that_meets_what_the_best_one_does_beside_its_numbers_begins_nowhere_else(
    monkeypatch: pytest.MonkeyPatch, closes: bool, begun: list[str]
) -> None:
    """Of two delays one was let go half-way, called worse: its joint's numbers had gone far to make up for it."""
    best, here = replace(trial_of("sensor_delay", 0.9), fit=SimpleNamespace(rms=1.0)), list[str]()
    monkeypatch.setattr(decide, "confused_with", lambda problem, effect: [SimpleNamespace(name="actuator_delay", place="joint")])
    monkeypatch.setattr(decide, "passes", lambda problem, t: True)
    monkeypatch.setattr(decide, "told_apart", lambda problem, worse, better: True)
    _refits_to(monkeypatch, replace(best, closed=0.89))
    monkeypatch.setattr(decide, "at_numbers_of", lambda few, fit: SimpleNamespace(rms=2.0, name="found"))
    monkeypatch.setattr(decide, "leaves_no_gap", lambda problem, fit: closes)
    monkeypatch.setattr(decide, "from_nearest", lambda problem, few, *more: here.append(few.name) or SimpleNamespace(rms=1.05))
    problem, fit = SimpleNamespace(settings=SimpleNamespace(threads=1)), SimpleNamespace(rms=2.0, name="fitted")
    found = decide.with_confusable(problem, fit, np.zeros(4), [], [best])
    assert here == begun and [t.candidate.effect for t in found] == ["sensor_delay", "actuator_delay"]


@pytest.mark.parametrize(("effect", "same"), [("actuator_delay", [0.0234]), ("load_friction", [])])
def test_a_twin_begins_with_the_quantities_of_the_best_one_that_it_has_too(effect: str, same: list[float]) -> None:
    """A delay of the commands as long as that of the measurements; friction knows no time, and begins in its strengths alone."""
    problem, best = still_problem(), trial_of("sensor_delay", 0.9)
    fit = fit_of(problem)
    best = replace(best, fit=having(problem, fit, best.candidate, {"time": 0.0234}))
    extended, absent = extend(fit, [place := placement(problem, Candidate(effect, ("tilt",)))])
    starts = as_much_as(best.fit, best.candidate)(problem, place, extended, absent)
    strengths = in_all_strengths(problem, place, extended, absent)
    assert [start[-1] for start in starts[: len(same)]] == pytest.approx(same) and len(starts) == len(same) + len(strengths)


@pytest.mark.parametrize(("effect", "heard"), [("payload", ["wrist"]), ("spring", ["wrist"]), ("cogging", [])])
def test_of_effects_on_links_the_outermost_link_is_heard_too(
    monkeypatch: pytest.MonkeyPatch, effect: str, heard: list[str]
) -> None:
    """The score test liked a negative payload on the upper arm; usual numbers had made up for most of what the wrist carries."""
    fit, known = SimpleNamespace(rms=2.0), [SimpleNamespace(name="payload", place="body")] if effect == "spring" else []
    best = replace(trial_of(effect, 0.9), fit=SimpleNamespace(rms=1.0))
    upper = replace(trial_of("payload", 0.2), candidate=Candidate("payload", ("upper_arm",)))
    monkeypatch.setattr(decide, "confused_with", lambda problem, effect: known)
    monkeypatch.setattr(decide, "passes", lambda problem, trial: trial is best)
    monkeypatch.setattr(decide, "told_apart", lambda problem, worse, better: True)
    _refits_to(monkeypatch, replace(best, closed=0.8))
    monkeypatch.setattr(decide, "placed_at", lambda problem, fit, targets, known: [])
    monkeypatch.setattr(
        decide,
        "elsewhere",
        lambda problem, fit, best: [Scored(Candidate(name, ("wrist",)), {}, 0.0) for name in ("payload", "hum")],
    )
    scored = [Scored(upper.candidate, {}, 0.3), Scored(Candidate("payload", ("wrist",)), {}, 0.1)]
    problem = SimpleNamespace(settings=SimpleNamespace(threads=1))
    found = decide.with_confusable(problem, fit, np.zeros(4), scored, [best, upper])
    assert [t.candidate for t in found if t not in (best, upper)] == [Candidate("payload", (link,)) for link in heard]
