"""What policies and the worlds they act in say to each other: observations, actions, outcomes."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, UInt8


@dataclass(frozen=True, eq=False)
class Observation:
    """What a policy sees at one step.

    Attributes:
        joints: measured positions [rad, or m for slides], grippers included, in the robot's actuator order, (A,).
        images: camera name -> RGB image (H, W, 3); empty without cameras. A world may take them only when they are first asked for,
            so whoever keeps an observation beyond the next step copies them.
    """

    joints: Float[np.ndarray, "A"]
    images: Mapping[str, UInt8[np.ndarray, "H W 3"]] = field(default_factory=dict)


@dataclass(frozen=True)
class Outcome:
    """How a trial stands, or how it ended.

    Attributes:
        success: whether the task is done.
        grasped: whether the object was ever held and lifted in this trial; None where a task has no grasp.
        distance: from the held object (or the end effector, where nothing is to be placed) to its target [m].
    """

    success: bool
    grasped: bool | None
    distance: float


@dataclass(frozen=True, eq=False)
class Conditions:
    """What a dream model is shown of one image of one camera.

    A frame-by-frame dreamer takes them as `Render(composite, robot, composite, object)`.

    Attributes:
        composite: robot and object pixels as rendered, black elsewhere, (H, W, 3).
        robot: share of each pixel that the robot covers, where no object hides it, as 0..255, (H, W).
        object: share of each pixel that the objects of the task cover, where the robot does not hide them, as 0..255, (H, W).
    """

    composite: UInt8[np.ndarray, "H W 3"]
    robot: UInt8[np.ndarray, "H W"]
    object: UInt8[np.ndarray, "H W"]


@dataclass(frozen=True)
class StartNoise:
    """How a trial begins otherwise than its start says, so that a policy without chance of its own does not do the same twice.

    Attributes:
        joints: standard deviation of the robot's resting pose [rad; a tenth of it in m for slides].
        objects: standard deviation of the objects' places on the table [m].
        seed: of this noise, apart from the start's own.
    """

    joints: float = 0.0
    objects: float = 0.0
    seed: int = 0


class World(ABC):
    """One workcell: a robot, a table and objects. The simulator and the stand-in for reality both are worlds.

    A world is deterministic: `reset` with the same arguments and the same actions give the same observations, bit for bit, whatever
    was done before. It is neither thread-safe nor picklable; give every process a world of its own.

    Attributes:
        rate: control steps per second [Hz].
        seconds: how long a trial of its task lasts [s].
        actions: number of actuators, A.
        cameras: names of the cameras in `Observation.images`.
        low, high: lowest and highest command of each actuator, (A,).
    """

    rate: float
    seconds: float
    actions: int
    cameras: tuple[str, ...]
    low: Float[np.ndarray, "A"]
    high: Float[np.ndarray, "A"]

    @property
    def steps(self) -> int:
        """Control steps of a whole trial."""
        return round(self.rate * self.seconds)

    @abstractmethod
    def reset(self, start: int, noise: StartNoise | None = None) -> Observation:
        """Begin a trial.

        Args:
            start: seed of the objects' poses, shapes and friction; the same start means the same poses in every world.
            noise: how this beginning differs from that start; not at all where None.
        """

    @abstractmethod
    def step(self, action: Float[np.ndarray, "A"]) -> Observation:
        """Hold position commands [rad or m] for every actuator for one period 1/`rate`; clipped to `low`..`high`.

        Raises:
            EdreamError: the action has another length or a value that is not finite.
        """

    @abstractmethod
    def outcome(self) -> Outcome:
        """How the trial stands now; at the end of a trial, how it ended."""

    @abstractmethod
    def state(self) -> Mapping[str, Float[np.ndarray, "7"]]:
        """Privileged: the pose of every object, x y z [m] and quaternion w x y z, in the robot's base frame."""

    def conditions(self) -> Mapping[str, Conditions]:
        """What a dream model is shown of this moment, camera name -> conditions; a real robot has none.

        Raises:
            NotImplementedError: this world cannot say which pixel shows what.
        """
        raise NotImplementedError(f"{type(self).__name__} has no conditions")

    def close(self) -> None:  # noqa: B027 - a world without cameras holds nothing
        """Free the graphics that this world holds."""
