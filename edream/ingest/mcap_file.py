"""MCAP files read front to back with every size bounded, so that a damaged or hostile file ends in a sentence."""

import struct
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

import lz4.frame
import zstandard
from mcap.exceptions import McapError
from mcap.records import Attachment, Channel, Chunk, Header, Message, Metadata, Schema
from mcap.stream_reader import StreamReader, breakup_chunk

from edream.core.errors import EdreamError
from edream.ingest.border import check_file, head, one_line

MAGIC = b"\x89MCAP0\r\n"
MAX_RECORD = 256 * 2**20
MAX_FILES = 100_000


@dataclass(frozen=True)
class Stamped:
    """One message as stored.

    Attributes:
        topic: its channel's topic.
        encoding: "cdr", "protobuf" or "json".
        schema: its schema record, or None.
        log_time, publish_time: its clocks [ns].
        data: the encoded message.
    """

    topic: str
    encoding: str
    schema: Schema | None
    log_time: int
    publish_time: int
    data: bytes


@dataclass(frozen=True)
class Topics:
    """What an MCAP file holds, as far as its first chunk tells.

    Attributes:
        profile: the header's profile, such as "ros2" or "edream".
        channels: (topic, message encoding, schema name) of each channel met.
    """

    profile: str
    channels: tuple[tuple[str, str, str], ...] = ()
    encodings: frozenset[str] = field(default_factory=frozenset)


def candidates(path: Path) -> list[Path]:
    """Files at `path` that are MCAP by content, or claim to be by suffix; sorted, none outside `path` by a link."""
    if path.is_file():
        return [path] if _may_be(path) else []
    root = path.resolve()
    found = []
    for count, file in enumerate(path.rglob("*") if path.is_dir() else ()):
        if count > MAX_FILES:
            raise EdreamError(f"{path} holds more than {MAX_FILES} files; point at the folder of the recordings.")
        if file.is_file() and _may_be(file) and file.resolve().is_relative_to(root):
            found.append(file)
    return sorted(found)


def _may_be(file: Path) -> bool:
    return file.suffix == ".mcap" or head(file, 8) == MAGIC


def recording_names(path: Path, files: list[Path]) -> list[str]:
    """A unique name for each file: its stem where those differ, else its path inside `path`."""
    stems = [file.stem for file in files]
    if len(set(stems)) == len(stems):
        return stems
    return [file.relative_to(path).with_suffix("").as_posix() for file in files]


def peek(file: Path) -> Topics | None:
    """Profile and channels from the first records of a file, or None where it is no readable MCAP file."""
    if head(file, 8) != MAGIC:
        return None
    profile, channels, schemas = "", [], {}
    try:
        for record in records(file):
            if isinstance(record, Header):
                profile = record.profile
            elif isinstance(record, Schema):
                schemas[record.id] = record.name
            elif isinstance(record, Channel):
                channels.append((record.topic, record.message_encoding, schemas.get(record.schema_id, "")))
            elif isinstance(record, Message):
                break
    except EdreamError:
        if not channels:
            return None
    return Topics(profile, tuple(channels), frozenset(encoding for _, encoding, _ in channels))


def records(file: Path) -> Iterator[Header | Schema | Channel | Message | Attachment | Metadata]:
    """Every record of a file in its order, chunks opened one by one.

    Raises:
        EdreamError: it is missing, no MCAP file, cut short or damaged.
    """
    check_file(file)
    if head(file, 8) != MAGIC:
        raise EdreamError(f"{file} is no MCAP file: it does not begin with the MCAP magic bytes.")
    with file.open("rb") as stream, _as_sentence(file):
        bounded = _Bounded(stream, file.stat().st_size)
        reader = StreamReader(bounded, emit_chunks=True, record_size_limit=MAX_RECORD)  # type: ignore[arg-type]
        for record in reader.records:
            if isinstance(record, Chunk):
                yield from breakup_chunk(_decompressed(record), validate_crc=True)  # type: ignore[misc]
            elif isinstance(record, Header | Schema | Channel | Message | Attachment | Metadata):
                yield record


def messages(file: Path, metadata: dict[str, dict[str, str]] | None = None) -> Iterator[Stamped]:
    """Every message of a file in its order.

    Args:
        file: the MCAP file.
        metadata: filled with the metadata records on the way, record name -> entries.

    Raises:
        EdreamError: see `records`.
    """
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    for record in records(file):
        if isinstance(record, Message):
            channel = channels.get(record.channel_id)
            if channel is None:
                raise EdreamError(f"{file} is damaged: a message belongs to channel {record.channel_id}, which is not declared.")
            schema = schemas.get(channel.schema_id)
            yield Stamped(channel.topic, channel.message_encoding, schema, record.log_time, record.publish_time, record.data)
        elif isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Channel):
            channels[record.id] = record
        elif isinstance(record, Metadata) and metadata is not None:
            metadata[record.name] = dict(record.metadata)


class _Bounded:
    """A file that never allocates more than it holds: `read(n)` of a buffered file reserves n bytes first."""

    def __init__(self, stream: BinaryIO, size: int) -> None:
        self._stream, self._left = stream, size

    def read(self, length: int = -1) -> bytes:
        data = self._stream.read(min(length, self._left) if length >= 0 else self._left)
        self._left -= len(data)
        return data


def _decompressed(chunk: Chunk) -> Chunk:
    """The same chunk, uncompressed within `MAX_RECORD`."""
    if chunk.uncompressed_size > MAX_RECORD:
        raise McapError(f"a chunk declares {chunk.uncompressed_size} bytes; expected at most {MAX_RECORD}")
    if chunk.compression == "zstd":
        # the frame's own header decides what zstandard allocates, so it is asked first
        if zstandard.frame_content_size(chunk.data) > MAX_RECORD:
            raise McapError(f"a chunk's zstd frame declares more than {MAX_RECORD} bytes")
        data = zstandard.ZstdDecompressor().decompress(chunk.data, max_output_size=max(chunk.uncompressed_size, 1))
    elif chunk.compression == "lz4":
        data = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=chunk.uncompressed_size)
    elif chunk.compression == "":
        data = chunk.data
    else:
        raise McapError(f"a chunk is compressed with {chunk.compression!r}; expected zstd, lz4 or none")
    if len(data) != chunk.uncompressed_size:
        raise McapError(f"a chunk holds {len(data)} bytes but declares {chunk.uncompressed_size}")
    chunk.compression, chunk.data = "", data
    return chunk


@contextmanager
def _as_sentence(file: Path) -> Iterator[None]:
    try:
        yield
    except (McapError, struct.error, zstandard.ZstdError, RuntimeError, ValueError, LookupError, EOFError, OSError) as error:
        reason = (
            "it ends in the middle of a record"
            if isinstance(error, struct.error) or "EndOfFile" in type(error).__name__
            else one_line(error)
        )
        raise EdreamError(f"{file} is damaged or cut short: {reason}.") from error
