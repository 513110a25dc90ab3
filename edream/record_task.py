"""`edream record task=...`: an expert works with the make-believe real robot, and leaves what a user with a robot would bring."""

import json
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from edream import catalog
from edream.core.camera import as_json
from edream.core.episode import Recording, Video
from edream.core.errors import EdreamError
from edream.core.format import Format
from edream.core.scene import ObjectTrack, Scene, SceneObject, scene_json
from edream.core.task import Task
from edream.reality.cell_look import placed_cameras
from edream.reality.filming import FILES
from edream.reality.recorder import Recorder
from edream.reality.truth import seal
from edream.reality.workcell import RealWorkcell
from edream.record import RecordConfig, hidden_robot, recorded_names, truth_path
from edream.sim.camera import graphics
from edream.sim.expert import Expert
from edream.sim.robot import RobotModel

FIRST = 10_000_000  # demonstrations begin where no trial of a policy does
TRIES = 2  # with another plan, before the expert gives a start up
GIVE_UP = 3  # starts tried for every demonstration wanted


def record_task(robot: RobotModel, task_name: str, config: RecordConfig, seed: int = 0) -> dict[str, Any]:
    """Record demonstrations of a task. Only those that succeeded are kept.

    Args:
        robot: the nominal robot.
        task_name: an entry of `edream/tasks/`.
        config: what is recorded.
        seed: of the truth, the starts, the expert's plans and the noise.

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
    task, form = catalog.load("tasks", task_name, Task), catalog.load("formats", config.format, Format)
    truth = hidden_robot(robot, config, seed, task=True)
    recorder = Recorder(config.control, config.jitter, config.noise, config.counts, config.step)
    look = config.cell if config.cell.cameras else None
    with graphics(), tempfile.TemporaryDirectory() as folder:
        world = RealWorkcell(robot, truth, task, config.control, look, recorder)
        takes, tried = _takes(world, Expert(robot, world.bench, task, config.control), config.episodes, seed, Path(folder))
        out.parent.mkdir(parents=True, exist_ok=True)
        form.write([recording for recording, _ in takes], out)
        names = recorded_names(form, out, [recording for recording, _ in takes], config.control)
        left = _leave(world, takes, names, out) if look else {}
        world.close()
    return {
        "data": str(out),
        "truth": str(sealed),
        "digest": seal(truth, sealed),
        "task": task_name,
        "format": config.format,
        "recordings": len(takes),
        "tried": tried,
        "seconds": float(sum(recording.times[-1] for recording, _ in takes)),
        "joints": list(robot.joints),
        **left,
    }


Take = tuple[Recording, dict[str, tuple[SceneObject, np.ndarray]]]


def _takes(world: RealWorkcell, expert: Expert, wanted: int, seed: int, folder: Path) -> tuple[list[Take], int]:
    """Demonstrations that succeeded, each with its things and their tracks; and how many were tried."""
    takes: list[Take] = []
    tried = 0
    for number in range(GIVE_UP * wanted):
        for attempt in range(TRIES):
            tried += 1
            take = _take(world, expert, FIRST + 10_000 * seed + number, attempt, len(takes), folder)
            if take is not None:
                takes.append(take)
                break
        if len(takes) == wanted:
            return takes, tried
    raise EdreamError(
        f"The expert of {world.task.name} succeeded only {len(takes)} times in {tried} trials, where {wanted} are wanted; "
        "hide other effects (record.effects) or take another seed."
    )


def _take(world: RealWorkcell, expert: Expert, start: int, attempt: int, number: int, folder: Path) -> Take | None:
    seen = world.reset(start)
    expert.begin(world.scene.layout, start + 1_000_003 * attempt)
    joints, commands = [], []
    images: dict[str, list[np.ndarray]] = {name: [] for name in world.cameras}
    poses: dict[str, list[np.ndarray]] = {thing.name: [] for thing in world.scene.layout.things}
    for _ in range(world.steps):
        joints.append(seen.joints)
        for name, image in seen.images.items():
            images[name].append(image)
        for name, pose in world.state().items():
            poses[name].append(pose)
        commands.append(np.clip(expert.act(seen, world.hand()), world.low, world.high))
        seen = world.step(commands[-1])
    if not world.outcome().success:
        return None
    times = np.arange(len(joints)) / world.rate
    name = f"episode_{number:06d}"
    videos = {camera: _video(times, np.stack(frames), folder / f"{name}_{camera}.npy") for camera, frames in images.items()}
    recording = Recording(
        name=name,
        times=times,
        channels=world.robot.joints,
        position=np.array(joints),
        command_times=times.copy(),
        command_channels=world.robot.joints,
        command=np.array(commands),
        videos=videos,
        notes={"robot": world.robot.name, "task": world.task.sentence},
    )
    return recording, {thing.name: (thing.proxy, np.array(poses[thing.name])) for thing in world.scene.layout.things}


def _video(times: np.ndarray, frames: np.ndarray, path: Path) -> Video:
    np.save(path, frames)

    def opened() -> Iterator[np.ndarray]:
        yield from np.load(path, mmap_mode="r", allow_pickle=False)

    return Video(times, frames.shape[1], frames.shape[2], opened)


def _leave(world: RealWorkcell, takes: Sequence[Take], names: Sequence[str], out: Path) -> dict[str, str]:
    """Write what lies beside the data set: cameras that stand still, things with their tracked poses, the empty bench."""
    assert world.look is not None
    kept = {what: end for what, end in FILES.items() if what != "truth masks"}
    paths = {what: out.with_name(out.name + end) for what, end in kept.items()}
    placed = placed_cameras(world.bench, world.look, int(world.truth.cell["look"]))
    still = {name: camera for name, camera in placed.items() if world.bench.view(name).on is None}
    objects = []
    for name, (first, _) in takes[0][1].items():
        sizes = np.mean([things[name][0].size for _, things in takes], axis=0)
        objects.append(replace(first, size=tuple(float(one) for one in sizes)))
    tracks = {
        told: {name: ObjectTrack(recording.times, poses) for name, (_, poses) in things.items()}
        for told, (recording, things) in zip(names, takes, strict=True)
    }
    paths["scene"].write_text(json.dumps(scene_json(Scene(tuple(objects), tracks))))
    if still:
        paths["cameras"].write_text(json.dumps(as_json(still), indent=1))
        first_view = next(iter(still))
        cv2.imwrite(str(paths["plate"]), world.photograph()[first_view][:, :, ::-1])
    return {what: str(path) for what, path in paths.items() if path.exists()}
