"""Masks that another program made: PNG files, .npz, or COCO run lengths."""

import json
import math
import zipfile
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from edream.core.errors import EdreamError
from edream.ingest.border import MAX_PIXELS, one_line, read_text
from edream.ingest.video import image_size

MAX_BYTES = 2**32  # of one file
BROKEN = (
    ValueError,
    KeyError,
    TypeError,
    OSError,
    IndexError,
    RecursionError,
    OverflowError,
    zipfile.BadZipFile,
    zlib.error,
    EOFError,
)


def read_masks(folder: Path, name: str) -> list[np.ndarray]:
    """One mask an image, (H, W), true where an object is, of the episode `name`: from NAME.npz, NAME.json or NAME/*.png.

    Raises:
        EdreamError: there is none of them, or it cannot be read.
    """
    table, lengths, pictures = folder / f"{name}.npz", folder / f"{name}.json", folder / name
    try:
        if table.is_file():
            return list(next(iter(read_arrays(table).values())) != 0)
        if lengths.is_file():
            return list(_decoded(json.loads(read_text(lengths))))
        if pictures.is_dir():
            return [_picture(path) for path in sorted(pictures.glob("*.png"))]
    except (*BROKEN, StopIteration) as error:
        raise EdreamError(f"Masks of episode {name!r} in {folder} cannot be read: {one_line(error)}.") from error
    raise EdreamError(f"There are no masks of episode {name!r} in {folder}; expected {name}.npz, {name}.json or {name}/*.png.")


def read_arrays(path: Path) -> dict[str, np.ndarray]:
    """The arrays (T, H, W) of an .npz file, by name; what they declare together is checked before memory is taken.

    Raises:
        EdreamError: it is no .npz of such arrays, or too large.
    """
    found, taken = {}, 0
    try:
        with zipfile.ZipFile(path) as archive:
            for member in archive.infolist():
                with archive.open(member) as file:
                    version = np.lib.format.read_magic(file)
                    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
                    shape, _, kind = read(file)
                taken += math.prod(shape) * kind.itemsize
                if len(shape) != 3 or kind.hasobject or taken > MAX_BYTES:
                    raise ValueError(
                        f"{member.filename} is {kind} of shape {shape}; expected numbers (T, H, W), {MAX_BYTES} bytes in all"
                    )
                with archive.open(member) as file:
                    found[member.filename.removesuffix(".npy")] = np.lib.format.read_array(file, allow_pickle=False)
    except (*BROKEN, RuntimeError, NotImplementedError) as error:
        raise EdreamError(f"{path} cannot be read as .npz of arrays (T, H, W): {one_line(error)}.") from error
    return found


def _picture(path: Path) -> np.ndarray:
    data = path.read_bytes()
    image_size(data, str(path))
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise ValueError(f"{path.name} is damaged")
    return np.asarray(image) > 0


def _decoded(rows: Any) -> Iterator[np.ndarray]:
    """COCO's run lengths, one an image; null where an image has no object, which takes the size of the others."""
    if not isinstance(rows, list) or not any(isinstance(row, dict) for row in rows):
        raise ValueError("expected a list of run lengths, one an image, and at least one that is not null")
    size = next(row for row in rows if isinstance(row, dict))["size"]
    for row in rows:
        yield _run_lengths({"size": size, "counts": [int(size[0]) * int(size[1])]} if row is None else row)


def _run_lengths(one: Any) -> np.ndarray:
    """A mask from run lengths: columns first, beginning with zeros."""
    height, width = (int(v) for v in one["size"])
    if not 0 < height * width <= MAX_PIXELS or height < 0:
        raise ValueError(f"a mask of {height} x {width}; expected 1 to {MAX_PIXELS} pixels")
    given = one["counts"]
    counts = _unpacked(given) if isinstance(given, str) else [int(v) for v in given]
    if not counts or min(counts) < 0 or sum(counts) != height * width:
        raise ValueError(f"run lengths sum to {sum(counts)}, not {height} x {width}")
    values = np.repeat(np.arange(len(counts)) % 2, counts)
    return values.reshape(width, height).T > 0


def _unpacked(text: str) -> list[int]:
    """COCO's compressed counts: five bits a character from "0" on, low ones first, the sixth says that more follow; the highest bit
    is the sign; from the fourth count on each is the difference to the one two before."""
    counts: list[int] = []
    value = shift = 0
    for letter in text:
        bits = ord(letter) - 48
        if not 0 <= bits < 64 or shift > 40:
            raise ValueError(f"compressed counts hold {letter!r}")
        value |= (bits & 31) << shift
        shift += 5
        if not bits & 32:
            value -= (1 << shift) if bits & 16 else 0
            counts.append(value + counts[-2] if len(counts) > 2 else value)
            value = shift = 0
    if shift:
        raise ValueError("compressed counts end in the middle of one")
    return counts
