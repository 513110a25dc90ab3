"""The trials of one stage in the calibrated simulator: which physics, whose eyes, which starts."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np

from edream import catalog
from edream.calibration.gripping import with_numbers
from edream.calibration.settings import SpaceSettings, simulated_robot
from edream.core.bench import bench_of
from edream.core.camera import from_json
from edream.core.errors import EdreamError, require
from edream.core.stage import Source
from edream.core.task import Task
from edream.practice.about import PolicyAbout
from edream.practice.collecting import Shard, split
from edream.practice.trial import Chance
from edream.practice.worlds import CompositeEyes, RawEyes, Workcell, open_workcell
from edream.sim.emit import emit
from edream.sim.robot import RobotModel

HOOK = "hook.py"


@dataclass(frozen=True)
class RolloutOptions:
    """Trials in the simulator; see `conf/rollouts/default.yaml` for each.

    Attributes:
        model: whose physics: fit, diagnose or published.
        physics: settings under which that is made, such as "data=motions": motions made for it tell more of a robot
            than its demonstrations do. Empty for the recordings that the policy learns from.
        eyes: what the policy is shown: raw, composite, dreamed or state (nothing but numbers).
        starts: how many starts, each of which is tried `samples` times.
        first: number of the first start.
        samples: trials of a start.
        draws: physics drawn from the calibrated posterior; 0 for the calibrated values alone.
        grip: largest relative change of contact friction between draws.
        noise: what else is left to chance.
        shard: trials that one process plays before it hands them in.
        supersampling: images are rendered so many times larger and averaged.
        plate: photo of the bench without robot and things, for composite eyes; the one that `masks` finds where None.
    """

    model: Literal["fit", "diagnose", "published"] = "fit"
    physics: str = ""
    eyes: Literal["raw", "composite", "dreamed", "state"] = "raw"
    starts: int = 300
    first: int = 10000
    samples: int = 3
    draws: int = 4
    grip: float = 0.2
    noise: Chance = field(default_factory=Chance)
    shard: int = 30
    supersampling: int = 1
    plate: Path | None = None

    def __post_init__(self) -> None:
        named = all("=" in word for word in self.physics.split())
        require(named, "rollouts.physics", repr(self.physics), "settings NAME=VALUE with a blank between two")
        require(self.starts >= 1, "rollouts.starts", self.starts, "at least 1")
        require(self.samples >= 2, "rollouts.samples", self.samples, "at least 2, for one to be better than another")
        require(self.shard >= 1, "rollouts.shard", self.shard, "at least 1")
        require(self.draws >= 0, "rollouts.draws", self.draws, "0 or more")
        require(0.0 <= self.grip < 1.0, "rollouts.grip", self.grip, "a share, 0 to below 1")

    @property
    def need(self) -> str:
        """What the physics comes from: a stage, and the settings under which it is made."""
        return physics_need(self.model, self.physics)


@dataclass(frozen=True, eq=False)
class Physics:
    """One simulated robot: MJCF, hook file, grip, and the time step [s] where it is another than the MJCF says."""

    mjcf: str
    hook: Path | None
    grip: float
    step: float | None = None


def physics_need(model: str, physics: str) -> str:
    """What a simulator's physics comes from: the stage `model`, and the settings `physics` under which it is made."""
    return " ".join([model, *physics.split()])


def needs_of(options: RolloutOptions) -> tuple[str, ...]:
    """Stages that trials with this physics and these eyes need."""
    physics = () if options.model == "published" else (options.need,)
    if options.eyes == "composite":
        return (*physics, "camera") if options.plate else (*physics, "camera", "masks")
    return (*physics, "camera", "condition", "dream") if options.eyes == "dreamed" else physics


def sources_of(options: RolloutOptions) -> dict[str, Source]:
    """Files that trials with these eyes need."""
    return {"plate": options.plate} if options.plate and options.eyes == "composite" else {}


def require_task(task: str, robot: RobotModel) -> None:
    """Refuse a task that does not exist, or a robot that has no workcell to do it in.

    Raises:
        EdreamError: naming what there is.
    """
    catalog.load("tasks", task, Task)
    bench_of(robot.name)


def physics_of(robot: RobotModel, made: Mapping[str, Any] | None, folder: Path) -> Physics:
    """The robot as published, or as a fit or a diagnosis left it.

    A diagnosis writes shorter steps where commands were recorded between longer ones. Trials give theirs at steps, and take the
    steps that it was found with.

    Args:
        made: file name -> value, as the stage made it; None for the published robot.
        folder: takes the hook file.
    """
    if made is None:
        return Physics(robot.mjcf, None, 1.0)
    about = made["summary.json"]
    hook = None
    if about.get("hook"):
        hook = folder / HOOK
        hook.write_text(made[about["hook"]])
    return Physics(made[about["model"]], hook, 1.0, about.get("step_s", {}).get("searched"))


def physics_for(
    robot: RobotModel, inputs: Mapping[str, Any], settings: SpaceSettings, options: RolloutOptions, folder: Path, seed: int
) -> list[Physics]:
    """The robots that trials are spread over: drawn from a fit's posterior where that is asked for, else one.

    Raises:
        EdreamError: something else than a fit is to be drawn from.
    """
    if options.draws and options.model == "fit":
        return drawn_physics(robot, inputs[options.need], settings, options, folder, seed)
    one = physics_of(robot, inputs.get(options.need), folder)
    rng = np.random.default_rng((seed, 0xF18))
    return [replace(one, grip=float(1.0 + options.grip * rng.uniform(-1.0, 1.0))) for _ in range(options.draws)] or [one]


def drawn_physics(
    robot: RobotModel, made: Mapping[str, Any], settings: SpaceSettings, options: RolloutOptions, folder: Path, seed: int
) -> list[Physics]:
    """Robots drawn from what a fit knows, the grip by its share.

    Raises:
        EdreamError: the fit's parameters are not those of the config.
    """
    simulated = simulated_robot(with_numbers(robot, made["summary.json"].get("grips", {})), settings)
    estimates = made["summary.json"]["parameters"]
    if set(estimates) != set(simulated.space.names):
        raise EdreamError("The fit's parameters are not those of fit.effects; calibrate with the same settings.")
    sets = drawn_values(estimates, made["details.json"]["correlation"], options.draws, seed)
    found = []
    for number, values in enumerate(sets):
        model = emit(simulated, np.array([values[name] for name in simulated.space.names]))
        hook = None
        if model.hook:
            hook = folder / f"hook_{number}.py"
            hook.write_text(model.hook)
        rng = np.random.default_rng((seed, 0xF18, number))
        found.append(Physics(model.mjcf, hook, float(1.0 + options.grip * rng.uniform(-1.0, 1.0))))
    return found


def drawn_values(
    estimates: Mapping[str, Mapping[str, Any]], correlation: Mapping[str, Any], count: int, seed: int
) -> list[dict[str, float]]:
    """Sets of parameters, normal within their intervals and correlated as the fit left them.

    What the data do not tell stays as it was fitted: its interval is its box, and a draw from that would be a mere guess.

    Args:
        estimates: name -> value, interval, status.
        correlation: names, and values (P, P).
    """
    names = [name for name, one in estimates.items() if one["status"] == "converged"]
    sets = [{name: float(one["value"]) for name, one in estimates.items()} for _ in range(count)]
    if not names:
        return sets
    rows = [correlation["names"].index(name) for name in names]
    matrix = np.array(correlation["values"])[np.ix_(rows, rows)]
    spread = np.array([(estimates[n]["interval"][1] - estimates[n]["interval"][0]) / (2 * 1.96) for n in names])
    weights, axes = np.linalg.eigh(0.5 * (matrix + matrix.T))
    root = axes * np.sqrt(np.maximum(weights, 0.0))
    for number, one in enumerate(sets):
        step = spread * (root @ np.random.default_rng((seed, 0xF17, number)).standard_normal(len(names)))
        for name, change in zip(names, step, strict=True):
            one[name] = float(np.clip(one[name] + change, *estimates[name]["interval"]))
    return sets


def cell_of(
    robot: RobotModel, physics: Physics, task: str, about: PolicyAbout, options: RolloutOptions, inputs: Mapping[str, Any]
) -> Workcell:
    """The workcell with this physics, seen as the eyes need it."""
    size, cameras, placed = (about.shape.height, about.shape.width), about.cameras, None
    if options.eyes in ("composite", "dreamed"):
        found = from_json(inputs["camera"]["cameras.json"], "cameras.json")
        if len(cameras) != 1 or cameras[0] not in found:
            raise EdreamError(
                f"rollouts.eyes={options.eyes} is for policies with one camera, {', '.join(found)}; this one has "
                f"{', '.join(cameras) or 'none'}: give policy.cameras."
            )
        placed = {cameras[0]: found[cameras[0]]}
        size = plate_image(inputs, options).shape[:2]
    return Workcell(
        robot.name,
        physics.mjcf,
        task,
        about.rate,
        cameras if options.eyes != "state" else (),
        int(size[0]),
        int(size[1]),
        dict(robot.assets),
        robot.site,
        physics.hook,
        placed,
        physics.grip,
        options.supersampling,
        physics.step,
    )


def plate_image(inputs: Mapping[str, Any], options: RolloutOptions) -> np.ndarray:
    """The background of the recordings, (H, W, 3).

    Raises:
        EdreamError: the file that is named is no image.
    """
    if options.plate is not None and options.eyes == "composite":
        return plate_of(options.plate)
    return _decoded(inputs["condition" if options.eyes == "dreamed" else "masks"]["plate.png"], "plate.png")


def plate_of(path: Path) -> np.ndarray:
    """A photo of the bench without robot and things, (H, W, 3).

    Raises:
        EdreamError: it is not there, or is no image.
    """
    if not path.is_file():
        raise EdreamError(f"There is no photo at {path}; rollouts.plate is one of the bench without robot and things.")
    return _decoded(path.read_bytes(), str(path))


def _decoded(data: bytes, where: str) -> np.ndarray:
    import cv2

    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    if image is None:
        raise EdreamError(f"{where} is no image; rollouts.plate is a photo of the bench without robot and things.")
    return np.ascontiguousarray(image[..., ::-1])


def open_composite(plate: np.ndarray) -> CompositeEyes:
    """For other processes."""
    return CompositeEyes(plate)


def open_raw() -> RawEyes:
    """For other processes."""
    return RawEyes()


def shards_of(cells: Sequence[Workcell], starts: range, samples: int, size: int) -> list[Shard]:
    """Every start tried so many times; the trials of one start are spread over the cells."""
    turns: list[list[tuple[int, int]]] = [[] for _ in cells]
    for start in starts:
        for sample in range(samples):
            turns[(start + sample) % len(cells)].append((start, sample))
    return [
        Shard(partial(open_workcell, cell), piece) for cell, some in zip(cells, turns, strict=True) for piece in split(some, size)
    ]


def calm(options: RolloutOptions) -> RolloutOptions:
    """The same without chance, for judging."""
    return replace(options, draws=0, noise=Chance())
