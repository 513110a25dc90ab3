"""Objects around the robot: what they look like in simulation and where they are, as far as anybody measured."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from edream.core.errors import EdreamError, unknown_name

SIZES = {"box": 3, "sphere": 1, "cylinder": 2, "ellipsoid": 3, "capsule": 2}


@dataclass(frozen=True)
class SceneObject:
    """A simulated object of plain shape.

    Attributes:
        name: what it is called.
        shape: box, sphere, cylinder, ellipsoid or capsule.
        size: half sizes, or radius and half length, as MuJoCo wants them [m].
        colour: RGB, 0..1.
    """

    name: str
    shape: str
    size: tuple[float, ...]
    colour: tuple[float, float, float]

    def __post_init__(self) -> None:
        if self.shape not in SIZES:
            raise unknown_name("shape", self.shape, SIZES)
        if len(self.size) != SIZES[self.shape] or not all(0.0 < size < np.inf for size in self.size):
            raise EdreamError(f"Object {self.name!r}: a {self.shape} needs {SIZES[self.shape]} sizes above 0 m, not {self.size}.")

    @property
    def size3(self) -> list[float]:
        """Its sizes, filled up to three."""
        return [*self.size, *[0.0] * (3 - len(self.size))]


@dataclass(frozen=True, eq=False)
class ObjectTrack:
    """Where an object was during one recording.

    Attributes:
        times: seconds since the recording began, (K,), rising.
        poses: x y z [m] in the robot's base frame and quaternion w x y z, (K, 7).
    """

    times: Float[np.ndarray, "K"]
    poses: Float[np.ndarray, "K 7"]

    def at(self, time: float) -> Float[np.ndarray, "7"]:
        """Its pose at a time [s]: between the two measurements around it, the quaternion normalised."""
        pose = np.array([np.interp(time, self.times, column) for column in self.poses.T])
        pose[3:] /= max(np.linalg.norm(pose[3:]), 1e-9)
        return pose


@dataclass(frozen=True, eq=False)
class Scene:
    """The objects and, for each recording, their tracks by name; empty where nothing is known."""

    objects: tuple[SceneObject, ...] = ()
    tracks: Mapping[str, Mapping[str, ObjectTrack]] | None = None

    def at(self, recording: str, time: float) -> dict[str, Float[np.ndarray, "7"]]:
        """Poses of all objects that are tracked in a recording, at a time [s]."""
        found = (self.tracks or {}).get(recording, {})
        return {name: track.at(time) for name, track in found.items()}


def scene_json(scene: Scene) -> dict[str, Any]:
    """A scene as JSON can say it."""
    return {
        "objects": [{"name": o.name, "shape": o.shape, "size": list(o.size), "colour": list(o.colour)} for o in scene.objects],
        "tracks": {
            recording: {name: {"times": t.times.tolist(), "poses": t.poses.tolist()} for name, t in tracks.items()}
            for recording, tracks in (scene.tracks or {}).items()
        },
    }


def scene_from_json(value: Any, where: str) -> Scene:
    """Inverse of `scene_json`.

    Raises:
        EdreamError: something is missing or has another shape.
    """
    try:
        objects = tuple(
            SceneObject(str(o["name"]), str(o["shape"]), tuple(map(float, o["size"])), tuple(map(float, o["colour"])))  # type: ignore[arg-type]
            for o in value["objects"]
        )
        tracks = {
            str(recording): {str(name): _track(one) for name, one in inside.items()}
            for recording, inside in value["tracks"].items()
        }
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise EdreamError(
            f"{where} is no scene ({type(error).__name__}: {error}); expected objects (name, shape, size, colour) and "
            "tracks {recording: {object: {times, poses}}}."
        ) from error
    names = {o.name for o in objects}
    for inside in tracks.values():
        for name in inside:
            if name not in names:
                raise unknown_name(f"object in {where}", name, names)
    return Scene(objects, tracks)


def _track(one: Any) -> ObjectTrack:
    times, poses = np.array(one["times"], float), np.array(one["poses"], float)
    finite = np.isfinite(poses).all() and np.isfinite(times).all()
    if times.ndim != 1 or poses.shape != (len(times), 7) or not len(times) or not finite or (np.diff(times) <= 0).any():
        raise ValueError("a track needs rising times and as many poses of 7 finite numbers")
    return ObjectTrack(times, poses)
