"""`edream record`: the make-believe real robot leaves a data set as a user would bring it, and the truth sealed beside it."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from edream import catalog
from edream.core.episode import Recording
from edream.core.errors import EdreamError
from edream.core.format import Format, ReadOptions
from edream.reality.cell_look import CellLook
from edream.reality.filming import Filming
from edream.reality.look import Look
from edream.reality.recorder import Recorder, make_recordings
from edream.reality.truth import Truth, draw, drawn_effects, seal, unseal, with_cell
from edream.sim.camera import graphics
from edream.sim.mass import HAND_WEIGHT, hand_of
from edream.sim.robot import RobotModel


@dataclass(frozen=True)
class RecordConfig:
    """What is recorded; see `conf/record/default.yaml`.

    Attributes:
        out: the new data set folder.
        effects: effects to hide; `drawn` stands for some that robots at work commonly have, which is what a task has where None.
        at: target of each effect, in order; drawn where missing.
        format: format of the data set.
        motions: number of recordings.
        seconds: length of each [s].
        gain: share of their usual position gain that the servos have; another than 1 is noted as the condition `servo_gain`.
        weight: what the hand holds [kg], known to whoever records; more than 0 is noted as the condition `hand_weight`.
        motion: a table of commands (time [s], then a column [rad or m] a joint) to play instead of motions drawn by chance, such as
            the `next_motion.csv` of a diagnosis; its length counts then.
        rate: rows per second [Hz].
        step: integration step [s].
        deviation: largest relative deviation of the nuisance parameters.
        smooth: speed [rad/s] over which dry friction comes up, so that a stuck joint creeps; 0 where it holds.
        noise: standard deviation of encoder noise [rad].
        counts: encoder counts per turn.
        jitter: standard deviation of the recorder's clock [s].
        video: whether a camera films it; its look and what moves about stand in `look`.
        truth: a sealed truth: the same robot again, in place of one drawn by chance.
        episodes: of a task: number of demonstrations.
        control: of a task: control steps per second [Hz].
        cell: of a task: its cameras.
    """

    out: Path
    effects: tuple[str, ...] | None = None
    at: tuple[str, ...] = ()
    format: str = "aloha_hdf5"
    motions: int = 12
    seconds: float = 10.0
    gain: float = 1.0
    weight: float = 0.0
    motion: Path | None = None
    rate: float = 50.0
    step: float = 0.0005
    deviation: float = 0.3
    smooth: float = 0.0
    noise: float = 0.0002
    counts: int = 16384
    jitter: float = 0.0003
    video: bool = False
    look: Look = field(default_factory=Look)
    truth: Path | None = None
    episodes: int = 50
    control: float = 25.0
    cell: CellLook = field(default_factory=CellLook)

    def __post_init__(self) -> None:
        for name in ("motions", "seconds", "rate", "step", "counts", "episodes", "control", "gain"):
            if getattr(self, name) <= 0:
                raise EdreamError(f"record.{name} is {getattr(self, name)}; expected a number above 0.")
        if self.step > 0.001:
            raise EdreamError(
                f"record.step is {self.step} s; expected at most 0.001 s, so that the robot is finer than its simulator."
            )
        for name in ("noise", "jitter", "weight", "smooth"):
            if getattr(self, name) < 0:
                raise EdreamError(f"record.{name} is {getattr(self, name)}; expected 0 or more.")
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
    truth, chance = hidden_robot(robot, config, seed), motion_seed(seed)
    noted = {"servo_gain": config.gain} if config.gain != 1.0 else {}
    noted |= {HAND_WEIGHT: config.weight} if config.weight else {}
    recorder = Recorder(config.rate, config.jitter, config.noise, config.counts, config.step, conditions=noted)
    filming = Filming(robot, config.look, seed) if config.video else None
    plan = None if config.motion is None else read_motion(config.motion, robot, config.rate)
    body, point = hand_of(robot)
    moved = truth.at_gain(robot.model, config.gain).holding(robot.model.body(body).name, point, config.weight)
    made = make_recordings(robot, moved, chance, config.motions, config.seconds, recorder, filming, plan)
    out.parent.mkdir(parents=True, exist_ok=True)
    if filming is None:
        form.write(made, out)
        filmed = {}
    else:
        with graphics():
            form.write(made, out)
            filmed = filming.leave(recorded_names(form, out, made, config.rate), out)
    return {
        "data": str(out),
        "truth": str(sealed),
        "digest": seal(truth, sealed),
        "format": config.format,
        "recordings": len(made),
        "seconds": float(sum(one.times[-1] for one in made)),
        "joints": list(robot.joints),
        **filmed,
    }


def motion_seed(seed: int) -> int:
    """The seed of the motions, noise and jitter of a recording session with this seed, apart from that of its truth."""
    return int(np.random.SeedSequence(seed).spawn(2)[1].generate_state(1)[0])


def hidden_robot(robot: RobotModel, config: RecordConfig, seed: int, task: bool = False) -> Truth:
    """What is true of the make-believe robot; the same seed and effects give the same, whether it is to move or to work.

    Raises:
        EdreamError: an effect or target does not exist, or `record.truth` is of another robot.
    """
    if config.truth is not None:
        truth = unseal(config.truth)
        if truth.robot != robot.name:
            raise EdreamError(f"{config.truth} is the truth of robot {truth.robot!r}, not {robot.name!r}.")
        return replace(truth, cameras={})  # other cameras may look on this time
    named = config.effects if config.effects is not None else ("drawn",) if task else ()
    effects = tuple(one for name in named for one in (drawn_effects(seed) if name == "drawn" else (name,)))
    rng = np.random.default_rng(np.random.SeedSequence(seed).spawn(2)[0])
    return with_cell(replace(draw(robot, effects, rng, config.deviation, config.at), smooth=config.smooth), seed)


def revealed(path: Path) -> list[str]:
    """What is hidden in a make-believe robot, in words; for readers of results, when all else is done.

    Raises:
        EdreamError: the file is no sealed truth.
    """
    return [f"{one.name} on {', '.join(one.targets) or 'all'}" for one in unseal(path).effects]


def read_motion(path: Path, robot: RobotModel, rate: float) -> Float[np.ndarray, "K J"]:
    """Commands of a table at `rate` rows per second, in the order of the model's joints, (K, J).

    Raises:
        EdreamError: there is no such file, or a joint has no column, or a number is missing or out of order.
    """
    if not path.is_file():
        raise EdreamError(f"There is no file {path}; record.motion is a CSV with columns time, {', '.join(robot.joints)}.")
    try:
        table = np.genfromtxt(path, delimiter=",", names=True, deletechars="", dtype=float, ndmin=1)
    except ValueError as error:
        raise EdreamError(f"{path} is not a table of numbers: {' '.join(str(error).split())[:200]}") from error
    names = table.dtype.names or ()
    for name in ("time", *robot.joints):
        if name not in names:
            raise EdreamError(f"{path} has no column {name!r}. What exists: {', '.join(names)}.")
    values = np.stack([table[name] for name in ("time", *robot.joints)], axis=1)
    if len(values) < 2 or not np.isfinite(values).all() or (np.diff(values[:, 0]) <= 0).any():
        raise EdreamError(f"{path} must have at least 2 rows of finite numbers with rising times.")
    clock = np.arange(0.0, values[-1, 0] - values[0, 0] + 1e-9, 1.0 / rate)
    order = [robot.joints.index(robot.model.joint(i).name) for i in range(robot.model.njnt)]
    return np.stack([np.interp(clock, values[:, 0] - values[0, 0], values[:, 1 + j]) for j in order], axis=1)


def recorded_names(form: Format, out: Path, made: Sequence[Recording], rate: float) -> list[str]:
    """What a reader of the data set will call each recording; a format may give names of its own."""
    names = [""] * len(made)
    for read in form.recordings(out, ReadOptions(fps=rate)):
        if isinstance(read, Recording):
            apart = [
                np.abs(read.position[0] - one.position[0]).sum() + np.abs(read.command[-1] - one.command[-1]).sum() for one in made
            ]
            names[int(np.argmin(apart))] = read.name
    return names


def truth_path(out: Path) -> Path:
    """Where the truth about a data set is sealed."""
    return out.with_name(out.name + ".truth.json")
