"""Masks that another program made: PNG files, .npz, or COCO run lengths."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from edream.core.errors import EdreamError
from edream.core.segmenter import Footage, Masks, Segmenter
from edream.ingest.mask_file import read_masks


class Precomputed(Segmenter):
    """Masks from `masks.folder`. For each episode NAME one of

    - `NAME.npz` with an array (T, H, W), not 0 where an object is,
    - `NAME.json`, a list of COCO run lengths, {"size": [H, W], "counts": ...}, one an image, or null; counts as a list, or as
      the text that COCO's own tools write,
    - `NAME/*.png`, one an image in the order of their names.

    There must be one mask for each rendered image (`render.rate`); sizes are brought to the images'.
    """

    name = "precomputed"
    summary = "masks from files: PNG, npz, COCO run lengths (masks.folder)"

    def masks(self, footage: Footage, options: Mapping[str, Any]) -> Masks:
        folder = options.get("folder")
        if folder is None:
            raise EdreamError("masks.segmenter=precomputed needs masks.folder=PATH.")
        found = read_masks(Path(folder), footage.name)
        count, height, width = footage.robot.shape
        if len(found) != count:
            raise EdreamError(f"Episode {footage.name!r}: {folder} holds {len(found)} masks; expected {count}, one for each image.")
        small = [cv2.resize(m.astype(np.float32), (width, height), interpolation=cv2.INTER_AREA) >= 0.5 for m in found]
        return (np.stack(small) & (footage.robot <= 127)).astype(np.uint8)


ENTRY = Precomputed()
