"""Trials that succeeded as something to imitate, and when a round has gone on too long."""

import numpy as np
import pyarrow as pa
import pytest

from edream import catalog
from edream.learn.preference import Preference
from edream.practice.imitating import Successes
from edream.practice.learning import Played, shall_stop
from tests.toy_world import about, demonstrated


def ranks(rows: list[tuple[int, int, bool]]) -> pa.Table:
    return pa.Table.from_pylist([{"trial": trial, "start": start, "good": good} for trial, start, good in rows])


def played_trials(about_, steps: int = 10) -> Played:
    rng = np.random.default_rng(2)
    count, decisions = 4, -(-steps // about_.stride)
    size = (about_.shape.height, about_.shape.width, 3)
    arrays = {
        "joints": rng.normal(size=(count, decisions, 2)).astype(np.float32),
        "images": rng.integers(0, 255, (count, decisions, 1, *size), dtype=np.uint8),
        "actions": np.arange(count * steps * 2, dtype=np.float32).reshape(count, steps, 2),
    }
    return Played.of([arrays], about_)


def test_chunks_of_successes_are_what_was_executed_and_each_start_counts_the_same() -> None:
    about_ = about([demonstrated(1), demonstrated(2)])
    played = played_trials(about_)
    # start 7 was done by three of its trials, start 8 by one, which therefore is drawn as often as those three together
    table = ranks([(0, 7, True), (1, 7, True), (2, 7, True), (3, 8, True)])
    batches = Successes.of(played, table, about_, 400, 0)
    _, actions, valid, _ = batches.at(3)
    found = about_.actions.back(actions.numpy())
    trials = ((found[:, 0, 0] + 0.5) // 20).astype(int)
    assert 0.4 < float((trials == 3).mean()) < 0.6 and set(trials.tolist()) == {0, 1, 2, 3}
    for chunk, real in zip(found, valid.numpy(), strict=True):
        assert real[0] and np.allclose(np.diff(chunk[real], axis=0), 2.0, atol=1e-2), "one step after the other"
    assert not valid.all(), "what lies beyond the end of a trial is padding"
    again = batches.at(3)[1]
    assert np.array_equal(actions.numpy(), again.numpy())


def test_trials_that_failed_are_not_imitated() -> None:
    about_ = about([demonstrated(1), demonstrated(2)])
    batches = Successes.of(played_trials(about_), ranks([(0, 7, False), (1, 7, True), (2, 8, False), (3, 8, False)]), about_, 50, 0)
    _, actions, _, _ = batches.at(0)
    assert set(((about_.actions.back(actions.numpy())[:, 0, 0] + 0.5) // 20).astype(int).tolist()) == {1}


@pytest.mark.parametrize(("chosen", "name", "stop"), [(-0.2, "tpo", False), (-0.6, "tpo", True), (-0.6, "grpo", False)])
def test_a_round_stops_when_the_chosen_trials_have_become_much_less_likely(chosen: float, name: str, stop: bool) -> None:
    entry = catalog.load("preferences", name, Preference)
    assert shall_stop([{"chosen": chosen}, {"chosen": chosen}], entry, 0.5) is stop
