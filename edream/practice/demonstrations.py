"""Demonstrations: recorded episodes as what was seen and what was commanded at each control step."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8

from edream.core.episode import Episode, Video
from edream.core.errors import EdreamError, unknown_name
from edream.learn.policy import Seen
from edream.practice.about import PolicyAbout
from edream.practice.changing import Scenes
from edream.practice.shaking import Shake, shaken
from edream.vision.frames import resized


@dataclass(frozen=True, eq=False)
class Demonstration:
    """One episode on the control clock.

    Attributes:
        name: of the episode.
        joints: measured positions at each step [rad or m], (T, A).
        actions: commands from each step on, likewise.
        images: (T, V, H, W, 3) uint8; V may be 0.
        state: further numbers that are seen, (T, S).
        masks: how much of each pixel robot and things cover, and the things alone, (T, 2, V, H, W), 0..255; None where unknown.
    """

    name: str
    joints: Float[np.ndarray, "T A"]
    actions: Float[np.ndarray, "T A"]
    images: np.ndarray
    state: Float[np.ndarray, "T S"]
    masks: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.joints)

    def masks_at(self, step: int) -> UInt8[np.ndarray, "2 V H W"]:
        """The masks of a step.

        Raises:
            EdreamError: they are not known.
        """
        if self.masks is None:
            raise EdreamError(f"Demonstration {self.name!r} has no masks; scenes can change only beside twins (sft.twins=true).")
        return self.masks[step]


@dataclass(frozen=True)
class View:
    """What of an episode a policy gets to see.

    Attributes:
        cameras: names, in the policy's order.
        height, width: size of each image [pixel].
        rate: control steps a second [Hz]; the commands' own where None.
    """

    cameras: tuple[str, ...]
    height: int
    width: int
    rate: float | None = None


def chosen_cameras(episodes: Iterable[Episode], wanted: tuple[str, ...] | None) -> tuple[str, ...]:
    """The cameras of a policy: those named, or all that every episode has.

    Raises:
        EdreamError: a camera is not there, or there is none and none was refused.
    """
    there: tuple[str, ...] | None = None
    for episode in episodes:
        names = tuple(episode.videos)
        there = names if there is None else tuple(name for name in there if name in names)
    there = there or ()
    for name in wanted or ():
        if name not in there:
            raise unknown_name("camera", name, there)
    if wanted is None and not there:
        raise EdreamError("The demonstrations hold no video; policy.cameras=[] trains a policy without eyes.")
    return there if wanted is None else wanted


def demonstration(
    episode: Episode, order: Sequence[str], view: View, path: Path, state: Float[np.ndarray, "T S"] | None = None
) -> Demonstration:
    """An episode on the control clock; at each step the newest measurement and image that were there by then.

    Args:
        order: the robot's actuated joints, in the order of its actuators.
        path: a new .npy file for the images, mapped into memory.
        state: further numbers, one row a step.

    Raises:
        EdreamError: a joint of the robot was not recorded.
    """
    for joint in order:
        if joint not in episode.joints:
            raise unknown_name(f"joint in episode {episode.name!r}:", joint, episode.joints)
    columns = [episode.joints.index(joint) for joint in order]
    steps = step_times(episode, view.rate)
    rows = _newest(episode.times, steps)
    commands = _newest(episode.command_times, steps)
    shape = (len(steps), len(view.cameras), view.height, view.width, 3)
    if view.cameras:
        images: np.ndarray = np.lib.format.open_memmap(path, mode="w+", dtype=np.uint8, shape=shape)
        for number, camera in enumerate(view.cameras):
            _film(episode.videos[camera], steps, images[:, number])
    else:
        images = np.zeros(shape, np.uint8)
    more = np.zeros((len(steps), 0)) if state is None else state
    return Demonstration(episode.name, episode.position[rows][:, columns], episode.command[commands][:, columns], images, more)


def step_times(episode: Episode, rate: float | None) -> Float[np.ndarray, "T"]:
    """When the control steps of an episode are: at its commands, or at a steady rate from its first command on."""
    times = episode.command_times
    if rate is None:
        return times
    return np.arange(times[0], times[-1] + 1e-9, 1.0 / rate)


def rate_of(episodes: Iterable[Episode], rate: float | None) -> float:
    """Control steps a second: as given, or the commands' own."""
    if rate is not None:
        return rate
    steps = [float(np.median(np.diff(episode.command_times))) for episode in episodes]
    return round(1.0 / float(np.median(steps)), 3)


def _newest(clock: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """The last row at or before each step (half a millisecond of a recorder's jitter counts as the same time)."""
    return np.clip(np.searchsorted(clock, steps + 5e-4, side="right") - 1, 0, len(clock) - 1)


def _film(video: Video, steps: np.ndarray, into: np.ndarray) -> None:
    due = _newest(video.times, steps)
    last = int(due.max())
    for row, image in enumerate(video.frames()):
        wanted = np.flatnonzero(due == row)
        if len(wanted):
            into[wanted] = resized(image, *into.shape[1:3])
        if row == last:
            break


@dataclass(frozen=True, eq=False)
class ChunkBatches:
    """Observations with the chunk of actions that followed; a batch follows from the seed and the step's number alone.

    Attributes:
        demonstrations: what is drawn from.
        about: the policy's scales and its chunk.
        part: which part of a batch is this process' own, and how many there are; each part has chances of its own.
        hidden: share of the samples of a batch whose joints are hidden.
        scenes: what scenes are changed into, or None to leave them; every demonstration then has masks.
    """

    demonstrations: Sequence[Demonstration]
    about: PolicyAbout
    batch: int
    seed: int
    shake: Shake | None = None
    part: tuple[int, int] = (0, 1)
    hidden: float = 0.0
    scenes: Scenes | None = None

    def at(self, step: int) -> tuple[Seen, torch.Tensor, Bool[torch.Tensor, "B H"], torch.Generator]:
        """The batch of a training step: what is seen, the actions (B, H, A), which of them are no padding, and a generator."""
        rng = np.random.default_rng((self.seed, 0xD3, step))
        lengths = np.array([len(one) for one in self.demonstrations])
        drawn = rng.integers(lengths.sum(), size=self.batch)
        numbers = np.searchsorted(np.cumsum(lengths), drawn, side="right")
        places = [(int(n), int(d - lengths[:n].sum())) for n, d in zip(numbers, drawn, strict=True)]
        own, parts = self.part
        if parts > 1:
            places, rng = places[own::parts], np.random.default_rng((self.seed, 0xD3, step, own))
        seen, actions, valid = self.of(places, rng)
        if self.hidden:
            seen = seen.without_joints(torch.from_numpy(rng.random(len(places)) < self.hidden))
        return seen, actions, valid, torch.Generator().manual_seed(int(rng.integers(2**62)))

    def of(
        self, places: Sequence[tuple[int, int]], rng: np.random.Generator | None = None
    ) -> tuple[Seen, torch.Tensor, Bool[torch.Tensor, "B H"]]:
        """The samples at some places: number of the demonstration and its step; changed and shaken where `rng` is given."""
        images = np.stack([self.demonstrations[n].images[t] for n, t in places])
        if self.scenes is not None and rng is not None:
            cover, things = np.stack([self.demonstrations[n].masks_at(t) for n, t in places], axis=1)
            images = self.scenes.changed(images, cover, things, rng)
        if self.shake is not None and rng is not None and images.shape[1]:
            images = shaken(images, self.shake, rng)
        joints = np.stack([self.demonstrations[n].joints[t] for n, t in places])
        state = np.stack([self.demonstrations[n].state[t] for n, t in places])
        chunks, valid = zip(*(chunk_of(self.demonstrations[n].actions, t, self.about.chunk) for n, t in places), strict=True)
        actions = torch.from_numpy(self.about.actions.into(np.stack(chunks)))
        return self.about.seen(joints, images, state), actions, torch.from_numpy(np.stack(valid))

    def every(self, apart: int) -> list[tuple[int, int]]:
        """Places `apart` steps from one another in all demonstrations."""
        return [(n, t) for n, one in enumerate(self.demonstrations) for t in range(0, len(one), apart)]


def chunk_of(actions: Float[np.ndarray, "T A"], first: int, length: int) -> tuple[Float[np.ndarray, "H A"], Bool[np.ndarray, "H"]]:
    """The actions from a step on, the last repeated where the episode ends, and which are no padding."""
    rows = np.arange(first, first + length)
    return actions[np.minimum(rows, len(actions) - 1)], rows < len(actions)
