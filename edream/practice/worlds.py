"""Simulated workcells for other processes: what one is made of, and how it is opened and seen."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from edream import catalog
from edream.core.camera import Camera
from edream.core.policy import Observation, World
from edream.core.task import Task
from edream.sim.eyes import Images
from edream.sim.robot import RobotModel
from edream.sim.workcell import SimulatedWorkcell
from edream.vision.dreamer import Dreamer, Past, Render


@dataclass(frozen=True)
class Workcell:
    """A simulated workcell as it can be sent to another process.

    Attributes:
        name: of the robot, which says at which bench it stands.
        mjcf: its model, published or calibrated.
        task: entry of `edream/tasks/`.
        rate: control steps a second [Hz].
        cameras: what is to be seen; none for a policy without eyes.
        height, width: size of the images [pixel].
        assets: files that the model names.
        site: its end effector.
        hook: the hook file of a calibrated model.
        placed: cameras as calibrated, in place of the bench's.
        grip: factor on all contact friction.
        supersampling: images are rendered so many times larger and averaged.
        step: the simulator's time step [s] where it is another than the model says.
    """

    name: str
    mjcf: str
    task: str
    rate: float
    cameras: tuple[str, ...]
    height: int
    width: int
    assets: Mapping[str, bytes] = field(default_factory=dict)
    site: str | None = None
    hook: Path | None = None
    placed: Mapping[str, Camera] | None = None
    grip: float = 1.0
    supersampling: int = 1
    step: float | None = None


def open_workcell(cell: Workcell) -> SimulatedWorkcell:
    """Open it. Images are rendered only when eyes ask for them.

    Raises:
        EdreamError: the robot has no bench, or there is no such task or camera.
    """
    robot = RobotModel(cell.name, cell.mjcf, cell.assets, cell.site, step=cell.step)
    task = catalog.load("tasks", cell.task, Task)
    seen = Images(cell.cameras, cell.height, cell.width, cell.placed, raw=False, supersampling=cell.supersampling)
    return SimulatedWorkcell(robot, task, cell.rate, seen, cell.hook, cell.grip)


class RawEyes:
    """The raw rendering, made only where a policy looks."""

    def begin(self, world: World, seed: int) -> None:
        """Nothing is remembered."""

    def look(self, world: World, observation: Observation) -> Mapping[str, np.ndarray]:
        return _simulated(world).raw()

    def cameras(self, world: World) -> tuple[str, ...]:
        return _simulated(world).images.cameras


def over(
    plate: UInt8[np.ndarray, "H W 3"], colour: UInt8[np.ndarray, "H W 3"], share: UInt8[np.ndarray, "H W"]
) -> UInt8[np.ndarray, "H W 3"]:
    """Colours over a background, each pixel by its share, 0..255."""
    weight = share[..., None] / 255.0
    return np.round(plate + weight * (colour.astype(float) - plate)).astype(np.uint8)


@dataclass(frozen=True, eq=False)
class CompositeEyes(RawEyes):
    """Simulated robot and objects before the background of the recordings.

    Attributes:
        plate: background image, (H, W, 3).
    """

    plate: np.ndarray

    def look(self, world: World, observation: Observation) -> Mapping[str, np.ndarray]:
        return {name: over(self.plate, *seen) for name, seen in _simulated(world).cutouts().items()}


class DreamedEyes(RawEyes):
    """What the dream model makes of the simulation, image by image, with its own memory of the trial.

    Args:
        dreamer: the model, before the background that belongs to the camera.
    """

    def __init__(self, dreamer: Dreamer) -> None:
        self._dreamer = dreamer
        self._past: Past | None = None

    def begin(self, world: World, seed: int) -> None:
        self._past = self._dreamer.start()

    def look(self, world: World, observation: Observation) -> Mapping[str, np.ndarray]:
        assert self._past is not None
        ((name, seen),) = _simulated(world).conditions().items()
        thing = seen.object
        # where an object hides the robot its share of the pixel is not the robot's, as in training
        self._past, image = self._dreamer.step(self._past, Render(seen.composite, seen.robot, seen.composite, thing))
        return {name: image}


def _simulated(world: World) -> SimulatedWorkcell:
    assert isinstance(world, SimulatedWorkcell)
    return world
