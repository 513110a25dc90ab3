"""Masks that another program made: PNG files, .npz, or COCO run lengths."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from edream.core.errors import EdreamError
from edream.core.segmenter import Footage, Masks, Segmenter


class Precomputed(Segmenter):
    """Masks from `masks.folder`. For each episode NAME one of

    - `NAME.npz` with an array (T, H, W), not 0 where an object is,
    - `NAME.json`, a list of COCO run lengths, {"size": [H, W], "counts": [...]} uncompressed, one an image, or null,
    - `NAME/*.png`, one an image in the order of their names.

    There must be one mask for each rendered image (`render.rate`); sizes are brought to the images'.
    """

    name = "precomputed"
    summary = "masks from files: PNG, npz, COCO run lengths (masks.folder)"

    def masks(self, footage: Footage, options: Mapping[str, Any]) -> Masks:
        folder = options.get("folder")
        if folder is None:
            raise EdreamError("masks.segmenter=precomputed needs masks.folder=PATH.")
        found = _read(Path(folder), footage.name)
        count, height, width = footage.robot.shape
        if len(found) != count:
            raise EdreamError(f"Episode {footage.name!r}: {folder} holds {len(found)} masks; expected {count}, one for each image.")
        small = [cv2.resize(m.astype(np.float32), (width, height), interpolation=cv2.INTER_AREA) >= 0.5 for m in found]
        return (np.stack(small) & (footage.robot <= 127)).astype(np.uint8)


def _read(folder: Path, name: str) -> list[np.ndarray]:
    table, lengths, pictures = folder / f"{name}.npz", folder / f"{name}.json", folder / name
    try:
        if table.is_file():
            with np.load(table, allow_pickle=False) as opened:
                return list(opened[opened.files[0]] != 0)
        if lengths.is_file():
            return [_run_lengths(one) for one in json.loads(lengths.read_text())]
        if pictures.is_dir():
            images = [cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in sorted(pictures.glob("*.png"))]
            if all(image is not None for image in images):
                return [np.asarray(image) > 0 for image in images]
            raise ValueError("a PNG is damaged")
    except (ValueError, KeyError, TypeError, OSError, IndexError, RecursionError) as error:
        raise EdreamError(f"Masks of episode {name!r} in {folder} cannot be read: {' '.join(str(error).split())}.") from error
    raise EdreamError(f"There are no masks of episode {name!r} in {folder}; expected {name}.npz, {name}.json or {name}/*.png.")


def _run_lengths(one: Any) -> np.ndarray:
    """COCO's uncompressed run lengths: columns first, beginning with zeros."""
    height, width = (int(v) for v in one["size"])
    counts = [int(v) for v in one["counts"]]
    if sum(counts) != height * width or min(counts) < 0:
        raise ValueError(f"run lengths sum to {sum(counts)}, not {height} x {width}")
    values = np.repeat(np.arange(len(counts)) % 2, counts)
    return values.reshape(width, height).T > 0


ENTRY = Precomputed()
