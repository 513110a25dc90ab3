"""Images in an ALOHA file, row by row."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from edream.core.errors import EdreamError
from edream.ingest import hdf5_file


@dataclass(frozen=True)
class RawRows:
    """Raw images of one camera, (rows, height, width, 3); `swap` where they are BGR."""

    file: Path
    name: str
    swap: bool

    def __call__(self) -> Iterator[UInt8[np.ndarray, "H W 3"]]:
        for image in _rows(self.file, self.name):
            yield np.ascontiguousarray(image[:, :, ::-1]) if self.swap else image


@dataclass(frozen=True)
class EncodedRows:
    """JPEG images of one camera, padded with zeros to rows of one length."""

    file: Path
    name: str

    def __call__(self) -> Iterator[bytes]:
        for row in _rows(self.file, self.name):
            # a JPEG ends in FF D9; the padding after it is zeros only
            yield row.tobytes().rstrip(b"\x00")


def _rows(file: Path, name: str) -> Iterator[np.ndarray]:
    with hdf5_file.opened(file) as opened:
        images = hdf5_file.dataset(opened, name, kinds="u")
        if images is None:
            raise EdreamError(f"{file} has no data set {name!r} any more.")
        for row in range(images.shape[0]):
            yield images[row]
