"""Condition: what the dream model is shown of each episode, layer by layer, and what it should make of it."""

from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from edream.core.camera import Camera, from_json
from edream.core.episode import Episode
from edream.core.errors import EdreamError
from edream.core.scene import Scene
from edream.core.stage import Artifact, Bundle, Source, Stage, Work
from edream.ingest.layered import images_of, layer, layered_bundle, layered_episodes, layered_shard
from edream.ingest.video import decode_image
from edream.vision.grain import measured_grain
from edream.vision.objects import Album, Crop, corners_of
from edream.vision.plate import brightness
from edream.vision.scene_file import read_scene
from edream.vision.views import plate_file, view_of


@dataclass(frozen=True)
class ConditionOptions:
    """How conditions are put together; see `conf/condition/default.yaml`."""

    reference: Literal["episode", "plate", "first"] = "episode"
    holdout_fraction: float = 0.2


@dataclass(frozen=True)
class ConditionRender:
    """Of the rendering only its scene counts here, and whether there is a robot."""

    scene: Path | None = None
    model: str = "fit"


@dataclass(frozen=True)
class ConditionConfig:
    """What condition reads."""

    condition: ConditionOptions
    render: ConditionRender
    seed: int


@dataclass(frozen=True, eq=False)
class Place:
    """What the views of one camera share.

    Attributes:
        plate: the background.
        camera: in the images' size; None where it moves or where there is no robot model.
        album: crops of the object, or None.
    """

    plate: np.ndarray
    camera: Camera | None
    album: Album | None = None


def run(inputs: Mapping[str, Artifact], config: ConditionConfig, work: Work) -> Bundle:
    """Join renderings, masks and recorded images into one sequence of layers a view."""
    rendered, scene = inputs["render"]["summary.json"], read_scene(config.render.scene)
    views = {episode.name: view_of(rendered, episode.name) for episode in layered_episodes(inputs["render"])}
    recordings = list(dict.fromkeys(recording for recording, _ in views.values()))
    apart = held_out(recordings, config.condition.holdout_fraction, config.seed)
    held = {name for name, (recording, _) in views.items() if recording in apart}
    places = _places(inputs, scene, views, held)
    grain = measured_grain(layers["real"] for episode, layers in _joined(inputs) if episode.name not in held)

    def one(item: tuple[Episode, dict[str, np.ndarray]], rng: np.random.Generator) -> Bundle:
        episode, layers = item
        recording, camera = views[episode.name]
        made = _layers(episode, layers, places[camera], _tracks(scene, recording, places[camera]), config.condition.reference)
        times = episode.videos["robot"].times
        videos = {name: layer(times[: len(images)], images) for name, images in made.items()}
        return layered_shard(
            episode, videos, work.folder("writing"), {"frames": len(times), "objects": float(made["masks"][..., 1].any())}
        )

    bundle, told = layered_bundle(work.shards("episodes", _joined(inputs), one, parallel=False))
    frames = sum(t["frames"] for t in told)
    crops = any(place.album is not None for place in places.values())
    sources = ["real"] + (["crop"] if crops else []) + (["sim"] if scene.tracks else [])
    summary = {
        "sentence": f"{frames} images of {len(told)} episodes, objects from {', '.join(sources)}.",
        "frames": frames,
        "object_sources": sources,
        "grain": grain.levels,
        "held": sorted(held),
    }
    return bundle | {"plate.png": inputs["masks"]["plate.png"], "summary.json": summary}


def held_out(names: list[str], fraction: float, seed: int) -> set[str]:
    """Episodes that no model sees while it is trained: at least one, and not all.

    Raises:
        EdreamError: there are fewer than two episodes, or the share is no share.
    """
    if len(names) < 2 or not 0.0 < fraction < 1.0:
        raise EdreamError(
            f"{len(names)} episodes cannot be split with condition.holdout_fraction={fraction:g}; expected two or more."
        )
    count = min(len(names) - 1, max(1, round(fraction * len(names))))
    return set(np.random.default_rng((seed, 0xD0)).choice(names, count, replace=False).tolist())


def _joined(inputs: Mapping[str, Artifact]) -> Iterator[tuple[Episode, dict[str, np.ndarray]]]:
    for rendered, masked in zip(layered_episodes(inputs["render"]), layered_episodes(inputs["masks"]), strict=True):
        layers = images_of(rendered, ("robot", "masks", "object"))
        found = images_of(masked, ("real", "object"))
        yield rendered, {**layers, "real": found["real"], "found": found["object"][..., 0]}


def _places(
    inputs: Mapping[str, Artifact], scene: Scene, views: Mapping[str, tuple[str, str]], held: Collection[str]
) -> dict[str, Place]:
    """Plate, camera and album of each camera; crops are in the plate's light, from the episodes that are not held out."""
    cameras = tuple(dict.fromkeys(camera for _, camera in views.values()))
    found = {}
    for name in cameras:
        plate = decode_image(inputs["masks"][plate_file(name, cameras)], "plate")
        native = from_json(inputs["camera"]["cameras.json"], "cameras.json")[name] if "camera" in inputs else None
        camera = None if native is None or native.moves else native.resized(*plate.shape[:2])  # a moved crop needs one view
        found[name] = Place(plate, camera)
    crops: dict[str, list[Crop]] = {name: [] for name in cameras}
    for episode, layers in _joined(inputs):
        if episode.name not in held:
            recording, name = views[episode.name]
            crops[name] += _crops(episode, layers, found[name], _tracks(scene, recording, found[name]))
    return {name: replace(place, album=Album.of(crops[name])) for name, place in found.items()}


Tracks = Callable[[float], np.ndarray | None]
"""Corners of the one tracked object's bounding box at a time [s]; None where there is none or several."""


def _tracks(scene: Scene, recording: str, place: Place) -> Tracks:
    def corners(time: float) -> np.ndarray | None:
        poses = scene.at(recording, time)
        if place.camera is None or len(scene.objects) != 1 or not poses:
            return None
        return corners_of(scene.objects[0], poses[scene.objects[0].name], place.camera)

    return corners


def _crops(episode: Episode, layers: Mapping[str, np.ndarray], place: Place, tracks: Tracks) -> list[Crop]:
    rows = range(0, len(layers["real"]), 5)
    real = layers["real"][rows].astype(np.float32)
    lit = real * brightness(real, place.plate.astype(np.float32))[:, None, None]
    found = []
    for row, image in zip(rows, np.clip(np.round(lit), 0, 255).astype(np.uint8), strict=True):
        mask = (layers["found"][row] > 127).astype(np.uint8)
        found.append(Crop(image, mask, tracks(float(episode.videos["robot"].times[row])), episode.name))
    return found


def _layers(
    episode: Episode, layers: Mapping[str, np.ndarray], place: Place, tracks: Tracks, reference: str
) -> dict[str, np.ndarray]:
    """The stored layers: real, condition (robot and recorded object pixels before black), robot, masks (robot, object as segmented,
    robot where the simulated object does not hide it), object_sim, object_crop, object_masks (simulated, crop),
    reference (one image)."""
    real, found, plate, album = layers["real"], layers["found"], place.plate, place.album
    robot, alone, both = layers["robot"], layers["masks"][..., 0], layers["masks"][..., 2]
    light = 1.0 / brightness(real[:1].astype(np.float32), plate.astype(np.float32))[0]
    crops, shares = np.zeros_like(real), np.zeros_like(found)
    if album is not None:
        for i, time in enumerate(episode.videos["robot"].times):
            corners = tracks(float(time))
            mask = (found[i] > 127).astype(np.uint8) if corners is None else None
            colour, shares[i] = album.seen(corners, mask, episode.name)
            crops[i] = np.clip(np.round(colour * (1.0 if reference == "plate" else light)), 0, 255).astype(np.uint8)
            hidden = both[i] > 127 if corners is not None else alone[i] > 127
            shares[i][hidden] = 0
    share = (alone[..., None] / 255.0) * (found[..., None] == 0)
    condition = np.round(robot * share + real * (found[..., None] > 0)).astype(np.uint8)
    if reference == "first":
        plate = real[0]
    elif reference == "episode":
        plate = np.clip(np.round(plate * light), 0, 255).astype(np.uint8)
    return {
        "real": real,
        "condition": condition,
        "robot": robot,
        "masks": np.stack([alone, found, both], axis=-1),
        "object_sim": layers["object"],
        "object_crop": crops,
        "object_masks": np.stack([layers["masks"][..., 1], shares, np.zeros_like(shares)], axis=-1),
        "reference": plate[None],
    }


def needs(config: ConditionConfig) -> tuple[str, ...]:
    """Renderings and masks, and the camera where a robot was rendered."""
    return ("render", "masks") if config.render.model == "none" else ("camera", "render", "masks")


def sources(config: ConditionConfig) -> Mapping[str, Source]:
    return {"scene": config.render.scene} if config.render.scene else {}


ENTRY = Stage("condition", 2, needs, ConditionConfig, run, sources, ("numpy", "opencv-python-headless"))
