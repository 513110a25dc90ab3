"""Masks: the background plate, and where objects are to be seen in each image."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from edream import catalog
from edream.core.episode import Episode
from edream.core.errors import EdreamError, unknown_name
from edream.core.segmenter import Footage, Segmenter
from edream.core.stage import Artifact, Bundle, Source, Stage, Work
from edream.ingest.layered import images_of, layer, layered_bundle, layered_episodes, layered_shard
from edream.ingest.mask_file import read_arrays
from edream.ingest.stored import stored_episodes
from edream.ingest.video import decode_image, encode_image
from edream.vision.frames import frames_at, resized
from edream.vision.plate import plate_of
from edream.vision.views import plate_file, view_of

OVERLAY = "overlay.png"


@dataclass(frozen=True)
class MaskOptions:
    """How objects are found; see `conf/masks/default.yaml` for each."""

    segmenter: str = "plate"
    plate: Path | None = None
    each: bool = False
    truth: Path | None = None
    folder: Path | None = None
    weights: Path | None = None
    options: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class MasksConfig:
    """What masks reads."""

    masks: MaskOptions


def run(inputs: Mapping[str, Artifact], config: MasksConfig, work: Work) -> Bundle:
    """Plate first, then every episode; where the truth is known, how good the masks are."""
    options = config.masks
    entry = catalog.load("segmenters", options.segmenter, Segmenter)
    for name in options.options:
        if name not in entry.options:
            raise unknown_name(f"option of segmenter {options.segmenter!r}:", name, entry.options)
    rendered = inputs["render"]["summary.json"]
    cameras = tuple(dict.fromkeys(camera for _, camera in rendered.get("views", {"": ("", rendered["camera"])}).values()))
    height, width = next(_footage(inputs))[1]["robot"].shape[1:3]
    plates = {name: _plate(inputs, options.plate, name, cameras, height, width) for name in cameras}
    truth = _truth(options.truth)
    extra = dict(options.options) | {k: v for k, v in (("folder", options.folder), ("weights", options.weights)) if v is not None}

    def one(item: tuple[Episode, dict[str, np.ndarray]], rng: np.random.Generator) -> Bundle:
        episode, layers = item
        common = plates[view_of(rendered, episode.name)[1]]
        own = plate_of([(layers["real"], layers["masks"][..., 0])], each=40) if options.each else common
        footage = Footage(episode.name, layers["real"], own, layers["masks"][..., 0], layers["masks"][..., 1])
        found = entry.masks(footage, extra)
        times = episode.videos["robot"].times
        about = {"share": float(found.mean()), "seen": float(found.any(axis=(1, 2)).mean())} | _judged(
            found, truth.get(episode.name), layers["rows"], height, width
        )
        kept = {"real": layer(times, layers["real"]), "object": layer(times, found * np.uint8(255))}
        strip = _strip(layers["real"], found)
        return dict(layered_shard(episode, kept, work.folder("writing"), about)) | {"strip.png": strip}

    shards = work.shards("episodes", _footage(inputs), one, parallel=False)
    bundle, told = layered_bundle(shards)
    overlay = np.concatenate([decode_image(shards[i]["strip.png"], "strip") for i in range(min(3, len(shards)))])
    bundle |= {OVERLAY: encode_image(overlay, "png")}
    bundle |= {plate_file(name, cameras): encode_image(plate, "png") for name, plate in plates.items()}
    summary = {
        "segmenter": options.segmenter,
        "plate": plate_file(cameras[0], cameras),
        "plate_from": "a file" if options.plate is not None else "the episodes",
        "object_share": float(np.mean([t["share"] for t in told])),
        "object_seen": float(np.mean([t["seen"] for t in told])),
    }
    judged = [iou for t in told for iou in t.get("iou", ())]
    words = f"Objects found by {options.segmenter!r} in {100 * summary['object_seen']:.0f} % of the images"
    if judged:
        summary |= {"iou_mean": float(np.mean(judged)), "iou_p10": float(np.quantile(judged, 0.1)), "iou_images": len(judged)}
        words += f"; IoU with the truth {summary['iou_mean']:.3f} (worst tenth {summary['iou_p10']:.3f})"
    return bundle | {"summary.json": {"sentence": f"{words}.", **summary}}


def _plate(
    inputs: Mapping[str, Artifact], given: Path | None, camera: str, cameras: Sequence[str], height: int, width: int
) -> np.ndarray:
    """A camera's plate: the one given, from a folder of CAMERA.png where there are several, or registered from its images."""
    if given is None:
        return plate_of((layers["real"], layers["masks"][..., 0]) for _, layers in _footage(inputs, camera))
    path = given if len(cameras) == 1 else given / f"{camera}.png"
    if not path.is_file():
        raise EdreamError(f"There is no plate at {path}; expected an image of the scene without robot and objects.")
    return resized(decode_image(path.read_bytes(), str(path)), height, width)


def _footage(inputs: Mapping[str, Artifact], only: str | None = None) -> Iterator[tuple[Episode, dict[str, np.ndarray]]]:
    """Each rendered view, of one camera or all, with its layers and the camera's own images of the same times."""
    rendered = inputs["render"]["summary.json"]
    recorded = {episode.name: episode for episode in stored_episodes(inputs["ingest"])}
    for episode in layered_episodes(inputs["render"]):
        recording, camera = view_of(rendered, episode.name)
        if only not in (None, camera):
            continue
        layers = images_of(episode, ("robot", "masks", "object"))
        video = recorded[recording].videos[camera]
        rows = np.searchsorted(video.times, episode.videos["robot"].times - 1e-6)
        height, width = layers["robot"].shape[1:3]
        yield episode, layers | {"real": np.stack(list(frames_at(video, rows, height, width))), "rows": rows}


def _truth(path: Path | None) -> Mapping[str, np.ndarray]:
    if path is None:
        return {}
    if not path.is_file():
        raise EdreamError(f"There are no true masks at {path}; expected .npz with an array (T, H, W) for each episode.")
    return read_arrays(path)


def _judged(found: np.ndarray, truth: np.ndarray | None, rows: np.ndarray, height: int, width: int) -> dict[str, Any]:
    """IoU of each image in which the object is truly there."""
    if truth is None:
        return {}
    if len(rows) and rows[-1] >= len(truth):
        raise EdreamError(f"masks.truth has {len(truth)} masks of an episode with {int(rows[-1]) + 1} images or more.")
    scores = []
    for mask, row in zip(found > 0, rows, strict=True):
        small = cv2.resize(truth[row].astype(np.float32), (width, height), interpolation=cv2.INTER_AREA) >= 0.5
        if small.any():
            scores.append(float((mask & small).sum() / (mask | small).sum()))
    return {"iou": scores}


def _strip(real: np.ndarray, found: np.ndarray) -> bytes:
    """Eight images with the objects' outlines in green."""
    rows = np.unique(np.linspace(0, len(real) - 1, 8).astype(int))
    shown = []
    for row in rows:
        large = np.ascontiguousarray(np.kron(real[row], np.ones((2, 2, 1), np.uint8)))
        lines, _ = cv2.findContours(np.kron(found[row], np.ones((2, 2), np.uint8)), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        shown.append(cv2.drawContours(large, lines, -1, (40, 255, 60), 1))
    return encode_image(np.concatenate(shown, axis=1), "png")


def sources(config: MasksConfig) -> Mapping[str, Source]:
    """Plate, truth, masks and weights from outside."""
    o = config.masks
    return {
        n: p for n, p in (("plate", o.plate), ("truth", o.truth), ("folder", o.folder), ("weights", o.weights)) if p is not None
    }


ENTRY = Stage("masks", 2, ("ingest", "render"), MasksConfig, run, sources, ("numpy", "opencv-python-headless"))
