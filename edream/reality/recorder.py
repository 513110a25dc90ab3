"""A recording session with the make-believe robot: motions in, recordings out, as a user's recorder would leave them."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from edream.core.episode import Recording, Video
from edream.reality.integrator import Track, move
from edream.reality.motions import commands
from edream.reality.truth import Truth
from edream.sim.robot import RobotModel

Film = Callable[[int, np.ndarray, np.ndarray], Mapping[str, Video]]


@dataclass(frozen=True)
class Recorder:
    """How the robot is recorded.

    Attributes:
        rate: rows per second [Hz].
        jitter: standard deviation of a row's time about its due time [s].
        noise: standard deviation of the encoder's noise [rad], or as a share of a slide's range [m].
        counts: encoder counts per turn, or over a slide's range.
        step: integration step of the robot [s].
        settle: how long the robot rests at the first command before the recording [s].
        conditions: facts noted with every recording.
    """

    rate: float = 50.0
    jitter: float = 0.0003
    noise: float = 0.0002
    counts: int = 16384
    step: float = 0.0005
    settle: float = 1.0
    conditions: Mapping[str, float] = field(default_factory=dict)


def make_recordings(
    robot: RobotModel,
    truth: Truth,
    seed: int,
    n_motions: int = 12,
    seconds: float = 10.0,
    recorder: Recorder | None = None,
    film: Film | None = None,
    plan: np.ndarray | None = None,
) -> list[Recording]:
    """Record the make-believe robot as it follows motions drawn from `seed`.

    Args:
        robot: the nominal robot, for its geometry and numbers.
        truth: what differs from it.
        seed: of motions, noise and jitter; the same seed gives the same motions whatever the truth.
        n_motions: how many recordings.
        seconds: length of each [s].
        recorder: how it is recorded.
        film: `film(index, times (T,), joints (T, nq))` gives the cameras' images of a motion, from where its links truly were.
        plan: commands that every motion follows instead, (K, J), `recorder.rate` rows a second.
    """
    recorder = recorder or Recorder()
    moving, noising = (np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(2))
    if plan is None:
        wanted = commands(robot.model, moving, n_motions, seconds, recorder.rate)
    else:
        wanted = np.repeat(plan[None], n_motions, axis=0)
    due = np.arange(wanted.shape[1]) / recorder.rate
    jitter = np.clip(noising.normal(0.0, recorder.jitter, wanted.shape[:2]), -0.2 / recorder.rate, 0.2 / recorder.rate)
    times = np.maximum(due + jitter, 0.0)
    times[:, 0] = 0.0
    track = perform(robot, truth, times, wanted, recorder.step, recorder.settle)
    return [_recording(robot, truth, recorder, track, times, wanted, index, noising, film) for index in range(n_motions)]


def perform(robot: RobotModel, truth: Truth, times: np.ndarray, wanted: np.ndarray, step: float, settle: float) -> Track:
    """Move the robot along commands that hold until the next, after it settled at the first.

    Args:
        times: when each row is commanded [s], (M, K), starting at 0.
        wanted: the commands [rad or m], (M, K, J).
        step: integration step [s].
        settle: rest at the first command [s].
    """
    before, length = round(settle / step), int(np.ceil(times[:, -1].max() / step)) + 1
    middles = (np.arange(-before, length) + 0.5) * step
    rows = np.stack([np.clip(np.searchsorted(t, middles, side="right") - 1, 0, None) for t in times], axis=1)
    held = wanted[np.arange(len(times))[None], rows]
    model = robot.model
    return move(truth.plant(model), truth.terms(model), wanted[:, 0], held, step, -before * step)


def _recording(
    robot: RobotModel,
    truth: Truth,
    recorder: Recorder,
    track: Track,
    times: np.ndarray,
    wanted: np.ndarray,
    index: int,
    rng: np.random.Generator,
    film: Film | None = None,
) -> Recording:
    model = robot.model
    plant = truth.plant(model)
    clock = np.arange(len(track.encoder)) * recorder.step - round(recorder.settle / recorder.step) * recorder.step
    encoder = track.encoder[:, index]
    seen = np.stack([np.interp(times[index], clock, column) for column in track.link[:, index].T], axis=1) if film else None
    for term in truth.terms(model):
        encoder = term.record(encoder, clock)
    position = np.stack([np.interp(times[index], clock, column) for column in encoder.T], axis=1)
    full = np.where(plant.tree.is_slide, model.jnt_range[:, 1] - model.jnt_range[:, 0], 2.0 * np.pi)
    unit = np.where(plant.tree.is_slide, full, 1.0)
    position = position + rng.normal(0.0, 1.0, position.shape) * recorder.noise * unit
    count = full / recorder.counts
    names = [model.joint(i).name for i in range(model.njnt)]
    order = [names.index(joint) for joint in robot.joints]
    return Recording(
        name=f"episode_{index:06d}",
        times=times[index].copy(),
        channels=robot.joints,
        position=(np.round(position / count) * count)[:, order],
        command_times=times[index].copy(),
        command_channels=robot.joints,
        command=wanted[index][:, order],
        conditions=dict(recorder.conditions),
        videos=film(index, times[index], seen) if film and seen is not None else {},
        notes={"robot": robot.name},
    )
