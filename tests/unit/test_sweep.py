"""The sweep: what it holds of the motions, and where its blocks are simulated."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from edream.core.episode import Episode
from edream.executor import Executor, Local
from edream.stages.sweep import SweepSettings, outline, windows_of
from edream.store import Store
from edream.work import StageWork


def episode(number: int) -> Episode:
    rng = np.random.default_rng(number)
    times = np.concatenate([[0.0], np.cumsum(rng.uniform(0.018, 0.022, 60 + 7 * number))])
    return Episode(
        name=f"motion-{number}",
        joints=("pan", "tilt"),
        times=times,
        position=rng.normal(size=(len(times), 2)),
        command_times=times[::2],
        command=rng.normal(size=(len(times[::2]), 2)),
        velocity=rng.normal(size=(len(times), 2)),
        conditions={"firmware_kp": 400.0},
    )


@dataclass
class Noted(Executor):
    """Does all jobs here, and says that it has other machines."""

    elsewhere: ClassVar[bool] = True
    seen: list[int] = field(default_factory=list)

    def run(self, task: Callable[[Any], None], jobs: Sequence[Any]) -> Iterator[int]:
        for index, job in enumerate(jobs):
            task(job)
            self.seen.append(job[0])
            yield index


def test_outlines_lead_to_the_stretches_of_the_motions_themselves_and_hold_none_of_their_numbers(tmp_path: Path) -> None:
    work = StageWork(Store(tmp_path), "sweep", "0123456789abcdef", Local(1))
    motions, options = [episode(n) for n in range(5)], SweepSettings(windows=9)
    outlines = [outline(one) for one in motions]
    found, true = (windows_of(some, options, work) for some in (outlines, motions))
    assert [(w.episode.name, w.first, w.last) for w in found] == [(w.episode.name, w.first, w.last) for w in true]
    assert len(found) == 9
    assert all(one.position.strides == one.command.strides == (0, 0) and one.velocity is None for one in outlines)


def test_work_for_all_cores_goes_elsewhere_only_where_there_are_other_machines(tmp_path: Path) -> None:
    far, near = Noted(), Noted()
    near.elsewhere = False  # type: ignore[misc]
    values = []
    for executor in (far, near):
        work = StageWork(Store(tmp_path / str(id(executor))), "sweep", "0123456789abcdef", executor)
        made = work.shards("blocks", [1.0, 2.0], lambda item, rng: {"found.json": item + rng.random()}, parallel="elsewhere")
        values.append([one["found.json"] for one in made])
    assert far.seen == [0, 1] and near.seen == []
    assert values[0] == values[1]
