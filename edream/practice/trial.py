"""A trial: one policy, one world, one start, from the first look to the outcome."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import torch
from jaxtyping import Float

from edream.core.errors import EdreamError, unknown_name
from edream.core.policy import Observation, Outcome, StartNoise, World
from edream.learn.policy import FittedPolicy
from edream.practice.about import PolicyAbout
from edream.vision.frames import resized


@dataclass(frozen=True)
class Chance:
    """Where trials of one start differ from one another; all zero for what the policy does when nothing is left to chance.

    Attributes:
        joints: standard deviation of the robot's resting pose [rad].
        objects: standard deviation of the objects' places [m].
        latent: standard deviation of the style variable z.
        action: standard deviation of an offset of the actions that wanders from chunk to chunk [spreads of the actions].
        memory: how much of that offset is left after a chunk, 0..1.
    """

    joints: float = 0.0
    objects: float = 0.0
    latent: float = 0.0
    action: float = 0.0
    memory: float = 0.7


@dataclass(frozen=True, eq=False)
class Trial:
    """What happened, at the D moments at which the policy decided.

    Attributes:
        start: number of the start.
        sample: which of the trials of that start.
        joints: seen at each decision [rad or m], (D, A).
        images: likewise, (D, V, H, W, 3).
        state: likewise, (D, S).
        actions: executed at every step [rad or m], (T, A).
        outcome: how it ended.
    """

    start: int
    sample: int
    joints: Float[np.ndarray, "D A"]
    images: np.ndarray
    state: Float[np.ndarray, "D S"]
    actions: Float[np.ndarray, "T A"]
    outcome: Outcome


class Eyes(Protocol):
    """How images of a world come about."""

    def begin(self, world: World, seed: int) -> None:
        """A new trial begins."""
        ...

    def look(self, world: World, observation: Observation) -> Mapping[str, np.ndarray]:
        """Camera name -> image, as the policy is shown it."""
        ...

    def cameras(self, world: World) -> tuple[str, ...]:
        """What there is to be seen."""
        ...


class OwnEyes:
    """The world's own images: the raw render of a simulator, the camera of a real robot."""

    def begin(self, world: World, seed: int) -> None:
        """Nothing is remembered."""

    def look(self, world: World, observation: Observation) -> Mapping[str, np.ndarray]:
        return observation.images

    def cameras(self, world: World) -> tuple[str, ...]:
        return world.cameras


class Plans:
    """Chunks that still reach into the future, and the action that they together mean for a step.

    With temporal ensembling (Zhao et al. 2023) every chunk that covers a step has a say, weight exp(-m i), i = 0 the oldest.
    """

    def __init__(self, ensemble: float | None) -> None:
        self._ensemble = ensemble
        self._chunks: list[tuple[int, Float[np.ndarray, "H A"]]] = []

    def add(self, step: int, chunk: Float[np.ndarray, "H A"]) -> None:
        """A chunk that begins at a step."""
        live = [one for one in self._chunks if one[0] + len(one[1]) > step] if self._ensemble is not None else []
        self._chunks = [*live, (step, chunk)]

    def action(self, step: int) -> Float[np.ndarray, "A"]:
        """What to do at a step."""
        said = np.stack([chunk[step - first] for first, chunk in self._chunks if 0 <= step - first < len(chunk)])
        weight = np.exp(-(self._ensemble or 0.0) * np.arange(len(said)))
        return (weight[:, None] * said).sum(axis=0) / weight.sum()


def play(
    world: World,
    network: FittedPolicy,
    about: PolicyAbout,
    eyes: Eyes,
    start: int,
    sample: int = 0,
    chance: Chance | None = None,
    seed: int = 0,
    film: list[Observation] | None = None,
) -> Trial:
    """Let a policy act from a start to the end of the trial.

    Args:
        sample: which of the trials of that start; sets its random numbers, with `seed` and the start.
        chance: what is left to chance; nothing where None.
        film: takes the world's observation of every step; None to take none.

    Raises:
        EdreamError: the world does not suit the policy.
    """
    check(world, about, eyes.cameras(world))
    chance = chance or Chance()
    rng = np.random.default_rng((seed, start, sample))
    noise = StartNoise(chance.joints, chance.objects, int(rng.integers(2**31)))
    device = next(network.parameters()).device
    z = torch.from_numpy(chance.latent * rng.standard_normal((1, network.latent))).float().to(device)
    offset = chance.action * rng.standard_normal(about.shape.actions)
    observation = world.reset(start, noise if chance.joints or chance.objects else None)
    eyes.begin(world, int(rng.integers(2**31)))
    plans, steps = Plans(about.ensemble), world.steps
    joints, images, states, actions = [], [], [], []
    for step in range(steps):
        if film is not None:
            film.append(replace(observation, images=dict(observation.images)))
        if step % about.stride == 0:
            row = _row(world, observation, eyes, about)
            for kept, value in zip((joints, images, states), row, strict=True):
                kept.append(value)
            with torch.no_grad():
                chunk = network.chunk(about.seen(*(value[None] for value in row)).to(device), z)[0].cpu().numpy()
            plans.add(step, about.actions.back(chunk + offset))
            fresh = np.sqrt(1.0 - chance.memory**2) * chance.action * rng.standard_normal(len(offset))
            offset = chance.memory * offset + fresh
        action = np.clip(plans.action(step), world.low, world.high)
        actions.append(action)
        observation = world.step(action)
    return Trial(start, sample, np.stack(joints), np.stack(images), np.stack(states), np.stack(actions), world.outcome())


def _row(world: World, observation: Observation, eyes: Eyes, about: PolicyAbout) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Joints, images and state as the policy sees them now."""
    size = (about.shape.height, about.shape.width)
    found = eyes.look(world, observation) if about.cameras else {}
    images = (
        np.stack([resized(found[name], *size) for name in about.cameras]) if about.cameras else np.zeros((0, *size, 3), np.uint8)
    )
    return observation.joints, images, state_of(world.state()) if about.shape.state else np.zeros(0)


def state_of(poses: Mapping[str, Float[np.ndarray, "7"]]) -> Float[np.ndarray, "S"]:
    """Poses of all objects as one vector: by name, place and the first two columns of the rotation.

    A quaternion's sign would jump.
    """
    rows = []
    for name in sorted(poses):
        w, x, y, z = poses[name][3:] / np.linalg.norm(poses[name][3:])
        first = (1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y))
        second = (2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x))
        rows.append(np.concatenate([poses[name][:3], first, second]))
    return np.concatenate(rows) if rows else np.zeros(0)


def check(world: World, about: PolicyAbout, cameras: tuple[str, ...]) -> None:
    """Refuse a world that a policy was not made for.

    Raises:
        EdreamError: number of actuators, rate or cameras differ.
    """
    if world.actions != about.shape.actions:
        raise EdreamError(
            f"The world has {world.actions} actuators and the policy {about.shape.actions} actions; expected as many."
        )
    if abs(world.rate - about.rate) > 0.02 * about.rate:
        raise EdreamError(
            f"The world steps at {world.rate:g} Hz and the policy at {about.rate:g} Hz; train it with policy.rate={world.rate:g}."
        )
    for camera in about.cameras:
        if camera not in cameras:
            raise unknown_name("camera in the world:", camera, cameras)
