"""TFRecord files and tf.train.Example messages, read without TensorFlow."""

import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from edream.core.errors import EdreamError
from edream.ingest.border import MAX_ROWS, check_file, head

MAX_RECORD = 512 * 2**20
VARINT, FIXED64, BYTES, FIXED32 = 0, 1, 2, 5
Feature = list[bytes] | np.ndarray


def crc32c(data: bytes) -> int:
    """CRC-32C (Castagnoli) of a few bytes."""
    value = 0xFFFFFFFF
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = (value >> 1) ^ (0x82F63B78 if value & 1 else 0)
    return value ^ 0xFFFFFFFF


def masked(data: bytes) -> int:
    """The masked CRC that a TFRecord stores."""
    value = crc32c(data)
    return (((value >> 15) | (value << 17)) + 0xA282EAD8) & 0xFFFFFFFF


def is_tfrecord(file: Path) -> bool:
    """Whether a file begins with a TFRecord header: a length and that length's own checksum."""
    start = head(file, 12)
    return len(start) == 12 and struct.unpack("<I", start[8:])[0] == masked(start[:8])


def records(file: Path, offset: int = 0) -> Iterator[tuple[int, bytes]]:
    """Offset and bytes of each record of a TFRecord file, from `offset` on.

    The checksum of each length is tested before it is believed; the payload's is left to the parser, for a pure Python
    CRC of images takes seconds.

    Raises:
        EdreamError: the file is cut short or damaged.
    """
    check_file(file)
    left = file.stat().st_size - offset
    with file.open("rb") as stream:
        stream.seek(offset)
        number = 0
        while left > 0:
            start = stream.read(12)
            if len(start) < 12 or struct.unpack("<I", start[8:])[0] != masked(start[:8]):
                raise EdreamError(f"{file} is damaged or cut short at record {number}: the checksum of its length is wrong.")
            (length,) = struct.unpack("<Q", start[:8])
            if length > MAX_RECORD or length + 16 > left:
                raise EdreamError(
                    f"{file} is cut short: record {number} has {length} bytes, the file holds {max(0, left - 16)} more."
                )
            yield offset, stream.read(length)
            stream.read(4)
            left -= length + 16
            offset += length + 16
            number += 1


def record_at(file: Path, offset: int) -> bytes:
    """The record that begins at `offset`.

    Raises:
        EdreamError: see `records`.
    """
    found = next(records(file, offset), None)
    if found is None:
        raise EdreamError(f"{file} holds no record at byte {offset} any more.")
    return found[1]


def example(data: bytes) -> dict[str, Feature]:
    """The features of a tf.train.Example: name -> list of bytes, or array of float32 or int64.

    Raises:
        ValueError: the bytes are no Example.
    """
    features: dict[str, Feature] = {}
    for number, wire, value in _fields(memoryview(data)):
        if (number, wire) != (1, BYTES):
            continue
        for inner, inner_wire, pair in _fields(value):
            if (inner, inner_wire) != (1, BYTES):
                continue
            parts = {n: v for n, w, v in _fields(pair) if w == BYTES}
            features[bytes(parts.get(1, b"")).decode("utf-8")] = _feature(parts.get(2, memoryview(b"")))
    return features


def _feature(data: memoryview) -> Feature:
    for number, wire, value in _fields(data):
        if wire != BYTES:
            continue
        if number == 1:
            return [bytes(item) for n, w, item in _fields(value) if (n, w) == (1, BYTES)]
        if number == 2:
            return _floats(value)
        if number == 3:
            return _integers(value)
    return []


def _floats(data: memoryview) -> np.ndarray:
    parts = []
    for _, wire, value in _fields(data):
        if wire in (BYTES, FIXED32):
            if len(value) % 4:
                raise ValueError("a list of floats is not a multiple of 4 bytes")
            parts.append(np.frombuffer(value, "<f4"))
    return np.concatenate(parts) if parts else np.zeros(0, np.float32)


def _integers(data: memoryview) -> np.ndarray:
    numbers: list[int] = []
    for _, wire, value in _fields(data):
        at = 0
        while wire in (BYTES, VARINT) and at < len(value):
            number, at = _varint(value, at)
            numbers.append(number - (1 << 64) if number >= 1 << 63 else number)
            if len(numbers) > MAX_ROWS:
                raise ValueError("a list of integers is too long")
    return np.array(numbers, dtype=np.int64)


def _fields(data: memoryview) -> Iterator[tuple[int, int, memoryview]]:
    """Field number, wire type and bytes of each field of a protobuf message; a varint as the bytes it stands in."""
    at = 0
    while at < len(data):
        key, at = _varint(data, at)
        wire, start = key & 7, at
        if wire == VARINT:
            _, at = _varint(data, at)
        elif wire == BYTES:
            size, start = _varint(data, at)
            at = start + size
        elif wire in (FIXED64, FIXED32):
            at += 8 if wire == FIXED64 else 4
        else:
            raise ValueError(f"wire type {wire} is unknown")
        if at > len(data):
            raise ValueError("a field reaches past the end")
        yield key >> 3, wire, data[start:at]


def _varint(data: memoryview, at: int) -> tuple[int, int]:
    value = shift = 0
    while at < len(data) and shift < 64:
        byte = data[at]
        value |= (byte & 0x7F) << shift
        at, shift = at + 1, shift + 7
        if byte < 0x80:
            return value & 0xFFFFFFFFFFFFFFFF, at
    raise ValueError("a number is cut short")
