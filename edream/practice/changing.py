"""Changed scenes: other backgrounds and other colours, so that a policy does not hang on the one bench it was shown."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import UInt8

from edream.core.errors import EdreamError, require
from edream.practice.worlds import over
from edream.vision.frames import resized

ENDINGS = (".png", ".jpg", ".jpeg")
EVEN = 0.15  # of an image's height: light and dark that is wider is the room's


@dataclass(frozen=True)
class Change:
    """How the scenes of training images are changed; see `conf/sft/default.yaml` for each.

    Attributes:
        share: share of the samples whose scene is changed, each by itself: no scene tells of its demonstration.
        folder: photos to take as backgrounds, or None to lay a flat patch onto the photo of the bench.
        colour: relative spread of the colours of the things in changed scenes.
    """

    share: float = 0.0
    folder: Path | None = None
    colour: float = 0.1

    def __post_init__(self) -> None:
        require(0.0 <= self.share <= 1.0, "sft.change.share", self.share, "a share, 0 to 1")
        require(self.colour >= 0.0, "sft.change.colour", self.colour, "0 or more")


@dataclass(frozen=True, eq=False)
class Scenes:
    """What scenes are changed into.

    Attributes:
        change: how much, and how often.
        plate: the photo of the empty bench, in the size of the policy's images.
        others: photos to take as backgrounds instead of it.
    """

    change: Change
    plate: UInt8[np.ndarray, "H W 3"]
    others: Sequence[UInt8[np.ndarray, "H W 3"]]

    def changed(
        self,
        images: UInt8[np.ndarray, "B 1 H W 3"],
        cover: UInt8[np.ndarray, "B 1 H W"],
        things: UInt8[np.ndarray, "B 1 H W"],
        rng: np.random.Generator,
    ) -> UInt8[np.ndarray, "B 1 H W 3"]:
        """The images, of some the background and the colours of the things changed; robot and things stay where they were.

        Args:
            cover: how much of each pixel robot and things cover, 0..255.
            things: how much of it the things cover.
        """
        out = images.copy()
        for row in np.flatnonzero(rng.random(len(images)) < self.change.share):
            background = changed_background(self.plate, self.others, rng)
            gain = 1.0 + self.change.colour * rng.standard_normal(3)
            out[row, 0] = over(background, tinted(images[row, 0], things[row, 0], gain), cover[row, 0])
        return out


def photos(folder: Path | None, height: int, width: int) -> list[UInt8[np.ndarray, "H W 3"]]:
    """Every photo of a folder, in the order of the names, in one size.

    Raises:
        EdreamError: there is no photo in it.
    """
    if folder is None:
        return []
    files = sorted(path for path in folder.glob("*") if path.suffix.lower() in ENDINGS)
    found = [cv2.imread(str(path), cv2.IMREAD_COLOR) for path in files]
    kept = [resized(np.ascontiguousarray(one[..., ::-1]), height, width) for one in found if one is not None]
    if not kept:
        raise EdreamError(f"There is no photo in {folder}; sft.change.folder needs some in {', '.join(ENDINGS)}.")
    return kept


def changed_background(
    plate: UInt8[np.ndarray, "H W 3"], others: Sequence[UInt8[np.ndarray, "H W 3"]], rng: np.random.Generator
) -> UInt8[np.ndarray, "H W 3"]:
    """One of the other photos, or the plate with a flat patch of any colour, size and angle on it, as of paper or cloth."""
    if len(others):
        return others[int(rng.integers(len(others)))]
    h, w = plate.shape[:2]
    middle = rng.uniform(0.1, 0.9, 2) * (w, h)
    size = rng.uniform(0.15, 0.7, 2) * (w, h)
    corners = cv2.boxPoints((tuple(middle.tolist()), tuple(size.tolist()), float(rng.uniform(0.0, 180.0))))
    # half of the patches are near white, as most paper is
    colour = rng.uniform(200, 250) * np.ones(3) + rng.normal(0, 6, 3) if rng.random() < 0.5 else rng.uniform(20, 240, 3)
    cover = np.zeros((h, w), np.uint8)
    cv2.fillConvexPoly(cover, np.round(corners * 16).astype(np.int32), 255, cv2.LINE_AA, 4)
    share = cover[..., None] / 255.0
    # the bench's own light and dark stay, its grain does not
    grey = cv2.GaussianBlur(plate.mean(axis=2), (0, 0), EVEN * h, borderType=cv2.BORDER_REPLICATE)[..., None]
    light = grey / max(float(plate.mean()), 1.0)
    mixed = plate + share * (np.clip(colour * (0.5 + 0.5 * light), 0, 255) - plate)
    return np.clip(np.round(mixed), 0, 255).astype(np.uint8)


def tinted(colour: UInt8[np.ndarray, "H W 3"], thing: UInt8[np.ndarray, "H W"], gain: np.ndarray) -> UInt8[np.ndarray, "H W 3"]:
    """The pixels of things with other colours; `gain` holds a factor for each channel."""
    share = thing[..., None] / 255.0
    return np.clip(np.round(colour * (1.0 + share * (gain - 1.0))), 0, 255).astype(np.uint8)
