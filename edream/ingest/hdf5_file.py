"""HDF5 files opened without following links out of them and without trusting their sizes."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import h5py
import numpy as np

from edream.core.errors import EdreamError
from edream.ingest.border import MAX_CHANNELS, MAX_ROWS, check_file, head, one_line

SIGNATURE = b"\x89HDF\r\n\x1a\n"
MAX_CHUNK = 256 * 2**20
MAX_ARRAY = 2 * 2**30


def is_hdf5(file: Path) -> bool:
    """Whether a file begins as HDF5 does."""
    return head(file, 8) == SIGNATURE


@contextmanager
def opened(file: Path) -> Iterator[h5py.File]:
    """An HDF5 file, open for reading; what h5py raises about it comes out as a sentence.

    Raises:
        EdreamError: it is missing, no HDF5 file, cut short or damaged.
    """
    check_file(file)
    if not is_hdf5(file):
        raise EdreamError(f"{file} is no HDF5 file: it does not begin with the HDF5 signature.")
    try:
        with h5py.File(file, "r", locking=False) as opened_file:
            yield opened_file
    except (OSError, RuntimeError, KeyError, ValueError, TypeError, OverflowError, MemoryError) as error:
        raise EdreamError(f"{file} is damaged or cut short: {one_line(error)}.") from error


def entry(group: h5py.Group, name: str) -> h5py.Group | h5py.Dataset | None:
    """A member of a group, or None where there is none.

    Raises:
        EdreamError: it is a soft or external link, or keeps its data in other files.
    """
    found: h5py.Group | h5py.Dataset = group
    for part in name.strip("/").split("/"):
        if not isinstance(found, h5py.Group) or part not in found.keys():  # noqa: SIM118 (`in group` follows links)
            return None
        link = found.get(part, getlink=True)
        if not isinstance(link, h5py.HardLink):
            target = getattr(link, "filename", None) or getattr(link, "path", "?")
            raise EdreamError(f"{group.file.filename}: {name!r} is, or lies behind, a link to {target!r}; links are not followed.")
        member = found[part]
        if isinstance(member, h5py.Datatype):
            return None
        found = member
    if isinstance(found, h5py.Dataset) and (found.external or found.is_virtual):
        raise EdreamError(f"{group.file.filename}: {name!r} keeps its data in other files; they are not opened.")
    return found


def dataset(group: h5py.Group, name: str, kinds: str = "fiub") -> h5py.Dataset | None:
    """A numeric data set of sane chunks, or None where there is none.

    Raises:
        EdreamError: see `entry`; or it is a group, holds no numbers, or declares chunks too large to open.
    """
    found = entry(group, name)
    if found is None:
        return None
    where = f"{group.file.filename}: {name!r}"
    if not isinstance(found, h5py.Dataset):
        raise EdreamError(f"{where} is a group; expected a data set.")
    if found.dtype.kind not in kinds or found.dtype.hasobject:
        raise EdreamError(f"{where} holds {found.dtype}; expected numbers.")
    if found.chunks and int(np.prod([int(n) for n in found.chunks], dtype=object)) * found.dtype.itemsize > MAX_CHUNK:
        raise EdreamError(f"{where} declares chunks of {found.chunks}; expected at most {MAX_CHUNK} bytes each.")
    return found


def table(group: h5py.Group, name: str) -> np.ndarray | None:
    """A (rows, columns) data set as float64, or None where there is none.

    Raises:
        EdreamError: see `dataset`; or it is not two-dimensional or too large.
    """
    found = dataset(group, name)
    if found is None:
        return None
    shape = found.shape
    if shape is None or len(shape) != 2 or shape[0] > MAX_ROWS or shape[1] > MAX_CHANNELS or shape[0] * shape[1] * 8 > MAX_ARRAY:
        raise EdreamError(
            f"{group.file.filename}: {name!r} has shape {shape}; expected (rows, channels), at most {MAX_ROWS} x {MAX_CHANNELS}."
        )
    with np.errstate(invalid="ignore"):  # a signalling NaN is named later, like any other
        return np.asarray(found[()], dtype=np.float64)


def texts(value: object) -> tuple[str, ...]:
    """An attribute that lists names; empty where it does not."""
    if isinstance(value, np.ndarray) and value.ndim == 1 and value.size <= MAX_CHANNELS:
        decoded = (one.decode("utf-8", "replace") if isinstance(one, bytes) else one for one in value.tolist())
        return tuple(one for one in decoded if isinstance(one, str))
    return ()
