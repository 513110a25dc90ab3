"""Which images of a video are used, and how large."""

from collections.abc import Iterator

import cv2
import numpy as np
from jaxtyping import Float, Int, UInt8

from edream.core.episode import Episode, Video
from edream.core.errors import EdreamError, unknown_name


def chosen_camera(names: tuple[str, ...], wanted: str | None) -> str:
    """The camera that is meant: the one named, or the first there is.

    Raises:
        EdreamError: there is none, or none of that name.
    """
    if not names:
        raise EdreamError("The recordings hold no video; edream dream needs recordings with at least one camera.")
    if wanted is None:
        return names[0]
    if wanted not in names:
        raise unknown_name("camera", wanted, names)
    return wanted


def rows_at(video: Video, rate: float | None) -> Int[np.ndarray, "T"]:
    """Rows of the images nearest to a steady rate [Hz]; all where the rate is None or above the video's own."""
    if rate is None:
        return np.arange(len(video.times))
    if rate <= 0:
        raise EdreamError(f"render.rate is {rate:g} Hz; expected a rate above 0.")
    due = np.arange(video.times[0], video.times[-1] + 1e-9, 1.0 / rate)
    right = np.clip(np.searchsorted(video.times, due), 1, len(video.times) - 1)
    nearest = np.where(due - video.times[right - 1] < video.times[right] - due, right - 1, right)
    return np.unique(nearest)


def resized(image: UInt8[np.ndarray, "H W 3"], height: int, width: int) -> UInt8[np.ndarray, "h w 3"]:
    """An image in another size; averaged where it shrinks."""
    if image.shape[:2] == (height, width):
        return image
    way = cv2.INTER_AREA if image.shape[0] >= height and image.shape[1] >= width else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(image, (width, height), interpolation=way))


def frames_at(video: Video, rows: Int[np.ndarray, "T"], height: int, width: int) -> Iterator[UInt8[np.ndarray, "h w 3"]]:
    """The images of some rows, resized; the video is read once and never held."""
    wanted = set(rows.tolist())
    for row, image in enumerate(video.frames()):
        if row in wanted:
            yield resized(image, height, width)


def positions_at(episode: Episode, positions: Float[np.ndarray, "T J"], times: Float[np.ndarray, "K"]) -> Float[np.ndarray, "K J"]:
    """Joint positions at the times of images, between the measurements around them."""
    return np.stack([np.interp(times, episode.times, column) for column in positions.T], axis=1)
