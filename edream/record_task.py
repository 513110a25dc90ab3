"""`edream record task=...`: an expert works with the make-believe real robot, and leaves what a user with a robot would bring."""

import json
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from edream import catalog
from edream.core.bench import bench_of
from edream.core.camera import as_json
from edream.core.episode import Recording, Video
from edream.core.errors import EdreamError
from edream.core.format import Format
from edream.core.scene import ObjectTrack, Scene, SceneObject, scene_json
from edream.core.task import Task
from edream.executor import Local
from edream.reality.cell_look import placed_cameras
from edream.reality.filming import FILES
from edream.reality.recorder import Recorder
from edream.reality.truth import Truth, seal
from edream.reality.workcell import RealWorkcell
from edream.record import RecordConfig, hidden_robot, recorded_names, truth_path
from edream.sim.camera import graphics
from edream.sim.expert import Expert
from edream.sim.robot import RobotModel

FIRST = 10_000_000  # demonstrations begin where no trial of a policy does
TRIES = 2  # with another plan, before the expert gives a start up
PIECE = 5  # demonstrations that a process plays before it hands them in
GIVE_UP = 3  # starts tried for every demonstration wanted


def record_task(robot: RobotModel, task_name: str, config: RecordConfig, seed: int = 0, workers: int = 1) -> dict[str, Any]:
    """Record demonstrations of a task. Only those that succeeded are kept.

    Args:
        robot: the nominal robot.
        task_name: an entry of `edream/tasks/`.
        config: what is recorded.
        seed: of the truth, the starts, the expert's plans and the noise.
        workers: processes; 0 for one a core. Their number changes nothing.

    Returns:
        A summary that says nothing of the truth: data, truth (path), digest, task, recordings, tried, cameras, scene, plate.

    Raises:
        EdreamError: there is no such task, effect or format, there is already something at `out`, or the expert fails too often.
    """
    out = Path(config.out)
    sealed = truth_path(out)
    for path in (out, sealed):
        if path.exists():
            raise EdreamError(f"There is already something at {path}; record.out must name a new folder.")
    if config.weight:
        raise EdreamError(f"record.weight is {config.weight:g}, but a task is demonstrated with an empty hand; expected 0.")
    if config.gain != 1.0:
        raise EdreamError(f"record.gain is {config.gain:g}, but a task is demonstrated at the servos' usual gain; expected 1.")
    task, form = catalog.load("tasks", task_name, Task), catalog.load("formats", config.format, Format)
    truth = hidden_robot(robot, config, seed, task=True)
    look = config.cell if config.cell.cameras else None
    with graphics(), tempfile.TemporaryDirectory() as folder:
        bare = RobotModel(robot.name, robot.mjcf, dict(robot.assets), robot.site)
        takes, tried = _takes(Session(bare, task_name, truth, config, seed, Path(folder)), workers)
        out.parent.mkdir(parents=True, exist_ok=True)
        form.write([take.recording for take in takes], out)
        names = recorded_names(form, out, [take.recording for take in takes], config.control)
        left = _leave(_world(robot, truth, task, config), takes, names, out) if look else {}
    seen = replace(truth, cameras=asdict(look) if look else {})
    return {
        "data": str(out),
        "truth": str(sealed),
        "digest": seal(seen, sealed),
        "task": task_name,
        "format": config.format,
        "recordings": len(takes),
        "tried": tried,
        "seconds": float(sum(take.recording.times[-1] for take in takes)),
        "joints": list(robot.joints),
        **left,
    }


@dataclass(frozen=True, eq=False)
class Session:
    """All that a process needs to play demonstrations; it leaves them in `folder`."""

    robot: RobotModel
    task: str
    truth: Truth
    config: RecordConfig
    seed: int
    folder: Path

    def start(self, number: int) -> int:
        """The start of a demonstration."""
        return FIRST + 10_000 * self.seed + number


@dataclass(frozen=True, eq=False)
class Take:
    """A demonstration that succeeded, with the things in it and their poses, (T, 7) each."""

    recording: Recording
    things: Mapping[str, tuple[SceneObject, np.ndarray]]


def _world(robot: RobotModel, truth: Truth, task: Task, config: RecordConfig) -> RealWorkcell:
    recorder = Recorder(config.control, config.jitter, config.noise, config.counts, config.step)
    return RealWorkcell(robot, truth, task, config.control, config.cell if config.cell.cameras else None, recorder)


def _takes(session: Session, workers: int) -> tuple[list[Take], int]:
    """Demonstrations that succeeded, in the order of their numbers; and how many trials it took."""
    wanted, takes, tried, first = session.config.episodes, [], 0, 0
    while len(takes) < wanted and first < GIVE_UP * wanted:
        numbers = range(first, first + wanted - len(takes))
        first = numbers.stop
        pieces = [(session, numbers[i : i + PIECE]) for i in range(0, len(numbers), PIECE)]
        for _ in Local(workers).run(_play, pieces):
            continue
        for number in numbers:
            with np.load(session.folder / f"{number}.npz", allow_pickle=False) as played:
                tried += int(played["tried"])
                if bool(played["success"]):
                    takes.append(_read(session, number, len(takes), played))
    if len(takes) == wanted:
        return takes, tried
    raise EdreamError(
        f"The expert of {session.task} succeeded only {len(takes)} times in {tried} trials, where {wanted} are wanted; "
        "hide other effects (record.effects) or take another seed."
    )


def _play(piece: tuple[Session, range]) -> None:
    """Play some demonstrations and leave each on disk."""
    session, numbers = piece
    with graphics():
        world = _world(session.robot, session.truth, catalog.load("tasks", session.task, Task), session.config)
        expert = Expert(session.robot, world.bench, world.task, world.rate)
        for number in numbers:
            for attempt in range(TRIES):
                played = _trial(world, expert, session.start(number), attempt)
                if world.outcome().success:
                    break
            for camera in world.cameras:
                np.save(session.folder / f"{number}_{camera}.npy", played.pop(f"image_{camera}"))
            told = {"tried": np.array(attempt + 1), "success": np.array(world.outcome().success)}
            np.savez(session.folder / f"{number}.npz", **played, **told)  # type: ignore[arg-type]
        world.close()


def _trial(world: RealWorkcell, expert: Expert, start: int, attempt: int) -> dict[str, np.ndarray]:
    seen = world.reset(start)
    expert.begin(world.scene.layout, start + 1_000_003 * attempt)
    rows: dict[str, list[np.ndarray]] = {}
    for _ in range(world.steps):
        command = np.clip(expert.act(seen, world.hand()), world.low, world.high)
        now = {"joints": seen.joints, "commands": command}
        now |= {f"image_{name}": image for name, image in seen.images.items()}
        now |= {f"pose_{name}": pose for name, pose in world.state().items()}
        for name, value in now.items():
            rows.setdefault(name, []).append(value)
        seen = world.step(command)
    return {name: np.array(values) for name, values in rows.items()}


def _read(session: Session, number: int, index: int, played: Mapping[str, np.ndarray]) -> Take:
    task = catalog.load("tasks", session.task, Task)
    times = np.arange(len(played["joints"])) / session.config.control
    recording = Recording(
        name=f"episode_{index:06d}",
        times=times,
        channels=session.robot.joints,
        position=played["joints"],
        command_times=times.copy(),
        command_channels=session.robot.joints,
        command=played["commands"],
        videos={name: _video(times, session.folder / f"{number}_{name}.npy") for name in session.config.cell.cameras},
        notes={"robot": session.robot.name, "task": task.sentence},
    )
    layout = task.layout(session.start(number), bench_of(session.robot.name).arms)
    return Take(recording, {thing.name: (thing.proxy, played[f"pose_{thing.name}"]) for thing in layout.things})


def _video(times: np.ndarray, path: Path) -> Video:
    def opened() -> Iterator[np.ndarray]:
        yield from np.load(path, mmap_mode="r", allow_pickle=False)

    size = np.load(path, mmap_mode="r", allow_pickle=False).shape
    return Video(times, size[1], size[2], opened)


def _leave(world: RealWorkcell, takes: Sequence[Take], names: Sequence[str], out: Path) -> dict[str, str]:
    """Write what lies beside the data set: cameras that stand still, things with their tracked poses, the empty bench."""
    assert world.look is not None
    kept = {what: end for what, end in FILES.items() if what != "truth masks"}
    paths = {what: out.with_name(out.name + end) for what, end in kept.items()}
    placed = placed_cameras(world.bench, world.look, int(world.truth.cell["look"]))
    still = {name: camera for name, camera in placed.items() if world.bench.view(name).on is None}
    objects = []
    for name, (first, _) in takes[0].things.items():
        sizes = np.mean([take.things[name][0].size for take in takes], axis=0)
        objects.append(replace(first, size=tuple(float(one) for one in sizes)))
    tracks = {
        told: {name: ObjectTrack(take.recording.times, poses) for name, (_, poses) in take.things.items()}
        for told, take in zip(names, takes, strict=True)
    }
    paths["scene"].write_text(json.dumps(scene_json(Scene(tuple(objects), tracks))))
    if still:
        paths["cameras"].write_text(json.dumps(as_json(still), indent=1))
        first_view = next(iter(still))
        cv2.imwrite(str(paths["plate"]), world.photograph()[first_view][:, :, ::-1])
    world.close()
    return {what: str(path) for what, path in paths.items() if path.exists()}
