"""The demonstrations of a data set, as a policy is trained on them."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from edream.core.episode import Episode
from edream.core.errors import EdreamError
from edream.core.scene import Scene
from edream.learn.policy import PolicyShape, Scale
from edream.practice.about import PolicyAbout
from edream.practice.changing import Scenes, photos
from edream.practice.demonstrations import Demonstration, View, chosen_cameras, demonstration, rate_of, step_times
from edream.practice.options import PolicyOptions, SftOptions
from edream.practice.trial import state_of
from edream.practice.twins import covered, twin_of
from edream.vision.scene_file import read_scene


def demonstrations(
    episodes: Sequence[Episode], order: Sequence[str], options: PolicyOptions, folder: Path
) -> tuple[list[Demonstration], tuple[str, ...], float]:
    """Every episode on the control clock, the cameras that the policy sees, and its rate [Hz].

    Args:
        order: the robot's actuated joints, in the order of its actuators.
        folder: takes the images.

    Raises:
        EdreamError: a camera, joint or object is missing.
    """
    cameras = chosen_cameras(episodes, options.cameras)
    view = View(cameras, options.height, options.width, options.rate)
    scene = read_scene(options.objects)
    made = [
        demonstration(episode, order, view, folder / f"{number:06d}.npy", tracked(scene, episode, options))
        for number, episode in enumerate(episodes)
    ]
    return made, cameras, rate_of(episodes, options.rate)


def with_twins(taught: Sequence[tuple[int, Demonstration]], twins: Mapping[str, Any] | None, folder: Path) -> list[Demonstration]:
    """Demonstrations, and beside them their twins where there are any; then all know where robot and things are in their images.

    Args:
        taught: each with its number in the data set.
        twins: file name -> arrays, as the stage twins made it.
        folder: takes the twins' images, and the masks.
    """
    if twins is None:
        return [one for _, one in taught]
    plain, seen = [], []
    for number, one in taught:
        twin = twins[f"twins/{number:06d}.safetensors"]
        plain.append(covered(one, twin, folder / f"masks-{number:06d}.npy"))
        seen.append(twin_of(plain[-1], twin["images"], folder / f"twin-{number:06d}.npy"))
    return plain + seen


def scenes_of(twins: Mapping[str, Any] | None, options: SftOptions) -> Scenes | None:
    """What scenes are changed into in training; None where they are left as they are."""
    if twins is None or not options.change.share:
        return None
    plate = twins["plate.safetensors"]["plate"]
    return Scenes(options.change, plate, photos(options.change.folder, *plate.shape[:2]))


def tracked(scene: Scene, episode: Episode, options: PolicyOptions) -> np.ndarray | None:
    """Poses of the scene's objects at each control step, as the policy sees them; None where it does not.

    Raises:
        EdreamError: nothing was tracked in this episode.
    """
    if options.objects is None:
        return None
    if not scene.at(episode.name, 0.0):
        raise EdreamError(f"{options.objects} has no track of any object in episode {episode.name!r}, which policy.objects needs.")
    return np.stack([state_of(scene.at(episode.name, float(time))) for time in step_times(episode, options.rate)])


def about_of(
    taught: Sequence[Demonstration], order: Sequence[str], cameras: tuple[str, ...], rate: float, options: PolicyOptions
) -> PolicyAbout:
    """The policy's form, its scales from the demonstrations it is trained on."""
    joints, actions, state = (np.concatenate([getattr(one, name) for one in taught]) for name in ("joints", "actions", "state"))
    shape = PolicyShape(len(order), options.chunk, len(cameras), options.height, options.width, state.shape[1])
    return PolicyAbout(
        kind=options.kind,
        options=dict(options.options),
        shape=shape,
        order=tuple(order),
        cameras=cameras,
        rate=rate,
        stride=options.stride,
        ensemble=options.ensemble,
        joints=Scale.of(joints),
        actions=Scale.of(actions),
        state=Scale.of(state),
    )


def held_out(count: int, share: float, seed: int) -> set[int]:
    """Numbers of the demonstrations that teach nothing: a share of them, at least one, never all.

    Raises:
        EdreamError: there are not two.
    """
    if count < 2:
        raise EdreamError(f"There is {count} demonstration; expected at least 2, one of them to be held out.")
    size = min(max(1, round(share * count)), count - 1)
    return set(np.random.default_rng((seed, 0x5F7)).permutation(count)[:size].tolist())
