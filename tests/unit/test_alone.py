"""A motion on which a gap rests alone: set aside, and what it shows found where that brings it down to the noise."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import edream
from edream.core.episode import Episode
from edream.diagnosis import alone
from edream.diagnosis.alone import Searched, explained, off_on, rests_on_one, searched
from edream.diagnosis.naming import Named
from edream.diagnosis.nuisance import fit_nuisance
from edream.diagnosis.problem import Problem, Settings, prepare
from edream.diagnosis.verdict import diagnose
from edream.diagnosis.wording import on_the_odd_one
from edream.reality.truth import Truth, draw
from edream.sim.robot import load_robot
from tests.stand_in import episodes_of

HEAD = load_robot(Path(edream.__file__).parent / "robots" / "pan_tilt.xml", site="ee")
FLOOR = 0.3e-3
LIMIT = 1.6  # N m, which the hardest of the motions asks for, and no other


def truth(*effects: str) -> Truth:
    drawn = draw(HEAD, ("payload", *effects), np.random.default_rng(6), 0.3, ("head",))
    return replace(drawn, effects=drawn.effects[1:])


def pushed(episode: Episode) -> Episode:
    """A motion in which somebody pushes at the head for a moment."""
    aside = 0.15 * np.exp(-(((episode.times - episode.times[0] - 2.0) / 0.15) ** 2))
    return replace(episode, position=episode.position + np.outer(aside, [0.0, 1.0]))


@pytest.mark.parametrize(
    ("errors", "on"),
    [
        ([0.3, 0.3, 0.3, 5.0, 0.3, 0.3], 3),
        ([0.3, 2.5, 0.3, 5.0, 2.5, 0.3], 3),
        ([0.3, 4.0, 0.3, 5.0, 4.0, 0.3], None),  # more of it is elsewhere
        ([0.3, 0.3, 0.3, 1.5, 0.3, 0.3], None),  # no clear gap
        ([0.3, 0.3, 0.3, 5.0], None),  # too few others
    ],
)
def test_a_gap_rests_on_one_motion_where_more_than_half_of_a_clear_one_does(errors: list[float], on: int | None) -> None:
    problem: Any = SimpleNamespace(floor=FLOOR)
    assert rests_on_one(problem, (1e-3 * np.array(errors)) ** 2) == on


def stand_in(*left: float, named: bool = False) -> Searched:
    """The end of a search that leaves so much on each motion [mrad], with a name or without."""
    last: Any = SimpleNamespace(taken=None, formula=None, errors=(1e-3 * np.array(left)) ** 2)
    first: Any = SimpleNamespace(taken="spring[tilt]", formula=None, errors=last.errors)
    problem: Any = SimpleNamespace(floor=FLOOR)
    fit: Any = SimpleNamespace()
    return Searched(problem, fit, [first, last] if named else [last])


AGREE = (0.3, 0.3, 0.3, 0.3, 0.3)


@pytest.mark.parametrize("off", [28e-3, 0.4e-3])
@pytest.mark.parametrize(
    ("at_first", "without", "formula", "borne_out", "aside"),
    [
        (False, stand_in(*AGREE, named=True), 0.0, True, True),
        (False, stand_in(*AGREE), 0.0, True, True),
        (False, stand_in(*AGREE), 0.0, False, False),  # where a servo just holds, or just not
        (True, stand_in(*AGREE, named=True), 0.0, False, True),
        (True, stand_in(*AGREE), 0.0, True, False),  # the name was known before
        (False, stand_in(0.3, 3.0, 0.3, 3.0, 0.3), 0.0, True, False),  # others have a gap of their own that has no name
        (False, stand_in(*AGREE), FLOOR, True, False),
        (False, stand_in(*AGREE), 4.0 * FLOOR, True, True),  # a formula that leaves a gap explains nothing
    ],
)
def test_a_motion_is_set_aside_where_the_others_tell_more_without_it(
    monkeypatch: pytest.MonkeyPatch, at_first: bool, without: Searched, formula: float, borne_out: bool, aside: bool, off: float
) -> None:
    before = stand_in(0.3, 0.3, 0.3, 5.0, 0.3, 0.3, named=at_first)
    windows = tuple(SimpleNamespace(number=number) for number in range(6))
    monkeypatch.setattr(alone, "_from_usual_numbers", lambda problem, done: before if len(problem.fitted) == 6 else without)
    monkeypatch.setattr(alone, "replace", lambda one, **new: SimpleNamespace(**vars(one) | new))
    described = SimpleNamespace(real=True, errors=np.full(6, formula**2)) if formula else None
    monkeypatch.setattr(alone, "find_remainder", lambda *of, **how: described)
    monkeypatch.setattr(alone, "bears_out", lambda found: borne_out)
    monkeypatch.setattr(alone, "off_on", lambda *of: (off, "tilt"))
    problem: Any = SimpleNamespace(floor=FLOOR, fitted=windows, proof=("nod",))
    found: Any = searched(problem)
    if aside and off < 3.0 * FLOOR:  # explained by what the others tell
        assert found.odd is None and found.problem.proof == ("nod", windows[3])
    elif aside:
        assert found.odd is windows[3] and found.rounds is without.rounds
    else:
        assert found is before


@pytest.fixture(scope="module")
def hard() -> tuple[Problem, Problem]:
    """A head whose tilt servo gives no more than `LIMIT`; and the same without the motion that asks for more."""
    limited = draw(HEAD, ("torque_saturation",), np.random.default_rng(6), 0.3, ("tilt",))
    limited = replace(limited, effects=(replace(limited.effects[0], values={"torque": LIMIT}),))
    settings = Settings(threads=1, holdout=("episode_000002", "episode_000005"))
    problem = prepare(HEAD, episodes_of(HEAD, limited, 6, 8, 5.0), settings)
    return problem, replace(problem, fitted=tuple(w for w in problem.fitted if w.episode.name != "episode_000001"))


def test_what_brings_one_motion_down_to_the_noise_beside_what_others_tell_is_what_it_shows(hard: tuple[Problem, Problem]) -> None:
    problem, others = hard
    odd = next(window for window in problem.fitted if window not in others.fitted)
    fit = fit_nuisance(others)
    error, joint = off_on(others, fit, odd)
    assert error > 5.0 * problem.floor and joint == "tilt"
    found = explained(others, fit, odd)
    assert found is not None and found.named.name == "torque_limit" and found.named.targets == ("tilt",)
    assert found.named.values["torque"] == pytest.approx(LIMIT, rel=0.2)  # one motion tells it and the damping within it together
    assert not found.confirmed  # none of those never fitted asks for as much
    assert odd in found.problem.fitted and found.problem.proof == problem.proof
    assert off_on(others, found.fit, odd)[0] < 1.2 * problem.floor


def test_what_motions_never_fitted_contradict_is_not_what_one_motion_shows(
    hard: tuple[Problem, Problem], monkeypatch: pytest.MonkeyPatch
) -> None:
    problem, others = hard
    odd = next(window for window in problem.fitted if window not in others.fitted)
    monkeypatch.setattr(alone, "gain_on_others", lambda problem, back, end: -(problem.floor**2))
    assert explained(others, fit_nuisance(others), odd) is None


def test_what_nothing_explains_is_set_aside_and_the_others_name_what_is_hidden() -> None:
    episodes = episodes_of(HEAD, truth("parallel_spring"), 6, 8, 5.0)
    episodes[3] = pushed(episodes[3])
    looked_for = ("spring", "torque_limit")
    found = diagnose(prepare(HEAD, episodes, Settings(effects=looked_for, holdout=("episode_000002", "episode_000005"))))
    assert [(one.name, one.targets) for one in found.effects] == [("spring", ("tilt",))]
    assert found.verdict == "named" and found.aside == ("episode_000003",)
    assert "episode_000003 was set aside: it alone is" in found.sentence and "most on tilt" in found.sentence
    assert found.after_rms < 1.2 * found.problem.floor
    assert "episode_000003" not in {window.episode.name for window in (*found.problem.fitted, *found.problem.proof)}


def test_words_for_a_motion_that_was_set_aside() -> None:
    limit = Named("torque_limit", "a limit of the motor torque", ("tilt",), {}, {}, {}, float("nan"), None, ())
    assert on_the_odd_one("lift", None, False, 0.0281, "tilt") == (
        " lift was set aside: it alone is 28 mrad off, most on tilt, which nothing that was tried explains, and would bend what the"
        " others say."
    )
    said = " Of the fitted motions lift alone shows the torque_limit; "
    assert on_the_odd_one("lift", limit, True, 0.0, "tilt") == f"{said}those never fitted confirm it."
    assert on_the_odd_one("lift", limit, False, 0.0, "tilt") == f"{said}no other motion confirms it; record more such motions."
