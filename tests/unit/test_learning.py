"""What a step of learning from trials looks at."""

from dataclasses import replace

import numpy as np
import pyarrow as pa
import pytest
import torch

from edream import catalog
from edream.learn.preference import Preference
from edream.learn.training import Schedule, new_state, train
from edream.practice.learning import Lessons, Meant, Places, Played, RlOptions, reference_of
from edream.practice.ranking import RankOptions, ranked
from edream.practice.shaking import Shake
from tests.toy_world import about, demonstrated

CPU = torch.device("cpu")
CALM = Shake(0.0, 0.0, 0.0, 0.0, 0)


def trials(about_, steps: int = 7) -> Played:
    """Five trials of seven steps, three of which a chunk executes: the last decision of each leads to one action alone."""
    rng = np.random.default_rng(4)
    size = (about_.shape.height, about_.shape.width, 3)
    arrays = {
        "joints": rng.normal(size=(5, 3, 2)).astype(np.float32),
        "images": rng.integers(0, 255, (5, 3, 1, *size), dtype=np.uint8),
        "actions": rng.normal(0.0, 0.1, (5, steps, 2)).astype(np.float32),
    }
    return Played.of([arrays], about_)


def lessons_of(name: str, played: Played, about_, network, batch: int = 8) -> Lessons:
    """Start 1 was done by trial 0 and not by trial 1; the trials of start 2 all failed alike."""
    rows = [(1, True), (1, False), (2, False), (2, False), (2, False)]
    outcomes = [{"trial": i, "start": s, "sample": i, "success": g, "distance": 0.2} for i, (s, g) in enumerate(rows)]
    order, pairs = ranked(pa.Table.from_pylist(outcomes), RankOptions(margin=1.0))
    reference = reference_of(network, played, about_, CPU)
    options = RlOptions(rounds=1, demonstrations=1.0, successes=1.0, checkpoint=100, held=40, batch=batch, shake=CALM)
    return Lessons(name, options, played, reference, order, pairs, 3)


@pytest.mark.parametrize("name", catalog.names("preferences"))
def test_under_the_reference_every_ratio_is_one_and_starts_that_tell_nothing_are_not_looked_at(name: str) -> None:
    about_ = about([demonstrated(1), demonstrated(2)])
    network = about_.network(seed=1)
    played = trials(about_)
    played.joints[2:] = np.nan  # whoever looks at the trials of start 2 gets no number
    lessons = lessons_of(name, played, about_, network)
    for step in range(5):
        assert torch.isfinite(lessons.loss(network, about_, lessons.at(step, about_), CPU))
    assert all(abs(told["chosen"]) < 1e-5 and abs(told["rejected"]) < 1e-5 for told in lessons.told)


def test_a_trial_s_likelihood_is_that_of_its_decisions_and_padding_has_none() -> None:
    about_ = about([demonstrated(1), demonstrated(2)])
    network, played = about_.network(seed=1), trials(about_)
    places = Places.whole([3, 1], played)
    assert places.trials.tolist() == [3, 3, 3, 1, 1, 1] and places.decisions.tolist() == [0, 1, 2, 0, 1, 2]
    meant = Meant.of(network, played, places, played.seen(places, about_), about_)
    size, off = meant.sum(torch.ones_like(meant.mean)), meant.sum((meant.actions - meant.mean).abs()) / about_.spread
    assert size.tolist() == [6, 6, 2] * 2
    wanted = -off - size * float(np.log(2.0 * about_.spread))
    assert torch.allclose(meant.likelihood(about_.spread, "laplace"), wanted, atol=1e-4)


@pytest.mark.parametrize("name", ["grpo", "natural"])
def test_learning_by_decisions_makes_the_better_trial_likelier_and_keeps_the_worse_one_within_reach(name: str) -> None:
    about_ = replace(about([demonstrated(1), demonstrated(2)]), spread=0.5)
    network, played = about_.network(seed=1), trials(about_)
    lessons = lessons_of(name, played, about_, network, batch=24)
    assert catalog.load("preferences", name, Preference).region
    steps = Schedule(60, 1e-4, 5, 0.9)
    train(network, lambda step: lessons.loss(network, about_, lessons.at(step, about_), CPU), new_state(network), 0, 60, steps)
    last = {name: float(np.mean([told[name] for told in lessons.told[-10:]])) for name in ("chosen", "rejected")}
    assert last["chosen"] > 0.05 > -0.05 > last["rejected"]
    assert last["rejected"] > -2.0, "beyond its region nothing pushes it any further"
