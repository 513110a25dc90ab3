"""A recorder that reads the robot after each step instead of before is found out, and only such a one."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import edream
from edream.core.episode import Episode
from edream.ingest.causality import answering_early, beware
from edream.ingest.findings import find, summarise
from edream.reality.truth import draw
from edream.sim.robot import load_robot
from tests.stand_in import episodes_of

HEAD = load_robot(Path(edream.__file__).parent / "robots" / "pan_tilt.xml", site="ee")


def recorded(effects: tuple[str, ...] = ()) -> list[Episode]:
    return episodes_of(HEAD, draw(HEAD, effects, np.random.default_rng(2), 0.3, ("tilt",)), 2, motions=4)


def read_after_the_step(episode: Episode) -> Episode:
    """The same motion by a recorder that notes a time and a command, takes the step, and then reads the robot."""
    held = np.searchsorted(episode.command_times, episode.times + 1e-3, side="right") - 1
    clock, command = episode.times, episode.command[held]
    return replace(episode, times=clock[:-1], position=episode.position[1:], command_times=clock, command=command)


@pytest.mark.parametrize("effects", [(), ("actuator_delay",), ("stribeck",), ("gear_ratio",)], ids=lambda e: "+".join(e) or "none")
def test_a_robot_that_is_read_before_its_step_answers_no_command_early(effects: tuple[str, ...]) -> None:
    assert answering_early(recorded(effects)) == ()


def test_a_robot_that_is_read_after_its_step_does_and_is_told_what_to_do() -> None:
    episodes = [read_after_the_step(one) for one in recorded()]
    assert "tilt" in answering_early(episodes)  # what turns the pan is mostly noise and friction in so short a time
    assert "ingest.command_shift=-1" in beware(episodes)
    assert any("tilt answer the command of their own row" in said for said in summarise([find(one) for one in episodes]))


def test_nothing_is_said_where_commands_have_their_own_clock_or_there_is_too_little() -> None:
    early = read_after_the_step(recorded()[0])
    apart = replace(early, command_times=early.command_times + 0.4 * np.median(np.diff(early.command_times)))
    short = replace(early, times=early.times[:50], position=early.position[:50])
    for some in ([apart], [short], []):
        assert answering_early(some) == () and beware(some) == ""
