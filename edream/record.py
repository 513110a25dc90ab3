"""`edream record`: the make-believe real robot leaves a data set as a user would bring it, and the truth sealed beside it."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from edream import catalog
from edream.core.errors import EdreamError
from edream.core.format import Format
from edream.reality.recorder import Recorder, make_recordings
from edream.reality.truth import draw, seal
from edream.sim.robot import RobotModel


@dataclass(frozen=True)
class RecordConfig:
    """What is recorded; see `conf/record/default.yaml`.

    Attributes:
        out: the new data set folder.
        effects: effects to hide.
        at: target of each effect, in order; drawn where missing.
        format: format of the data set.
        motions: number of recordings.
        seconds: length of each [s].
        rate: rows per second [Hz].
        step: integration step [s].
        deviation: largest relative deviation of the nuisance parameters.
        noise: standard deviation of encoder noise [rad].
        counts: encoder counts per turn.
        jitter: standard deviation of the recorder's clock [s].
    """

    out: Path
    effects: tuple[str, ...] = ()
    at: tuple[str, ...] = ()
    format: str = "aloha_hdf5"
    motions: int = 12
    seconds: float = 10.0
    rate: float = 50.0
    step: float = 0.0005
    deviation: float = 0.3
    noise: float = 0.0002
    counts: int = 16384
    jitter: float = 0.0003

    def __post_init__(self) -> None:
        for name in ("motions", "seconds", "rate", "step", "counts"):
            if getattr(self, name) <= 0:
                raise EdreamError(f"record.{name} is {getattr(self, name)}; expected a number above 0.")
        if self.step > 0.001:
            raise EdreamError(
                f"record.step is {self.step} s; expected at most 0.001 s, so that the robot is finer than its simulator."
            )
        if not 0.0 <= self.deviation < 1.0:
            raise EdreamError(f"record.deviation is {self.deviation}; expected a share from 0 to below 1.")


def record(robot: RobotModel, config: RecordConfig, seed: int = 0) -> dict[str, Any]:
    """Record the make-believe robot.

    Args:
        robot: the nominal robot.
        config: what is recorded.
        seed: of the truth, the motions and the noise.

    Returns:
        A summary for the user that says nothing of the truth: data, truth (path), digest, format, recordings, seconds, joints.

    Raises:
        EdreamError: an effect, target or format does not exist, or there is already something at `out`.
    """
    out = Path(config.out)
    sealed = truth_path(out)
    for path in (out, sealed):
        if path.exists():
            raise EdreamError(f"There is already something at {path}; record.out must name a new folder.")
    form = catalog.load("formats", config.format, Format)
    truths, motions = np.random.SeedSequence(seed).spawn(2)
    truth = draw(robot, config.effects, np.random.default_rng(truths), config.deviation, config.at)
    recorder = Recorder(config.rate, config.jitter, config.noise, config.counts, config.step)
    made = make_recordings(robot, truth, int(motions.generate_state(1)[0]), config.motions, config.seconds, recorder)
    out.parent.mkdir(parents=True, exist_ok=True)
    form.write(made, out)
    return {
        "data": str(out),
        "truth": str(sealed),
        "digest": seal(truth, sealed),
        "format": config.format,
        "recordings": len(made),
        "seconds": float(sum(one.times[-1] for one in made)),
        "joints": list(robot.joints),
    }


def truth_path(out: Path) -> Path:
    """Where the truth about a data set is sealed."""
    return out.with_name(out.name + ".truth.json")
