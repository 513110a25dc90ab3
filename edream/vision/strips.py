"""Pictures for the report: film strips, and short clips that a browser plays from the page itself."""

import io
from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import UInt8

SHOWN = 8  # images in a row


def film_strip(rows: Sequence[UInt8[np.ndarray, "T H W 3"]], shown: int = SHOWN, scale: int = 2) -> UInt8[np.ndarray, "h w 3"]:
    """Clips below each other, each as a row of images evenly spread over time, separated by thin white lines."""
    lines = []
    for clip in rows:
        which = np.unique(np.linspace(0, len(clip) - 1, min(shown, len(clip))).astype(int))
        images = [
            cv2.resize(np.ascontiguousarray(clip[i]), None, fx=scale, fy=scale, interpolation=cv2.INTER_NEAREST) for i in which
        ]
        gap = np.full((images[0].shape[0], 2, 3), 255, np.uint8)
        row = np.concatenate([part for image in images for part in (image, gap)][:-1], axis=1)
        lines += [row, np.full((2, row.shape[1], 3), 255, np.uint8)]
    return np.concatenate(lines[:-1])


def side_by_side(clips: Sequence[UInt8[np.ndarray, "T H W 3"]], rate: float, scale: int = 3) -> bytes:
    """Clips next to each other as an animated PNG that loops; the same bytes for the same images.

    Args:
        rate: images per second [Hz].
    """
    from PIL import Image

    frames = []
    for images in zip(*clips, strict=True):
        large = [cv2.resize(np.ascontiguousarray(i), None, fx=scale, fy=scale, interpolation=cv2.INTER_NEAREST) for i in images]
        frames.append(Image.fromarray(np.concatenate(large, axis=1)))
    out = io.BytesIO()
    frames[0].save(out, "PNG", save_all=True, append_images=frames[1:], duration=round(1000.0 / rate), loop=0)
    return out.getvalue()
