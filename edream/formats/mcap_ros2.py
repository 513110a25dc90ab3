"""MCAP recordings of ROS 2 topics (CDR): sensor_msgs/JointState, a torque switch, voltages, images."""

import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from mcap.exceptions import McapError
from mcap_ros2._vendor.rosidl_adapter.parser import InvalidSpecification, InvalidValue
from mcap_ros2.decoder import DecoderFactory

from edream.core.episode import Recording
from edream.core.errors import EdreamError
from edream.core.format import Format, Malformed, ReadOptions
from edream.ingest import mcap_file
from edream.ingest.border import finished, one_line
from edream.ingest.mcap_file import Stamped
from edream.ingest.signals import JointTopic, Signals, assemble

DECODE_ERRORS = (
    McapError,
    InvalidSpecification,
    InvalidValue,
    struct.error,
    ValueError,
    LookupError,
    TypeError,
    AttributeError,
    NotImplementedError,
    RecursionError,
)


class McapRos2(Format):
    """Joint states on a measured and a commanded topic, each on its own clock.

    Source: mcap.dev specification; docs.ros.org sensor_msgs/msg/JointState.
    """

    name = "mcap_ros2"
    summary = "MCAP files with ROS 2 messages (CDR)"

    def recognise(self, path: Path) -> str | None:
        for file in mcap_file.candidates(path):
            topics = mcap_file.peek(file)
            if topics and "cdr" in topics.encodings:
                return f"{file.name} is an MCAP file with CDR messages"
        return None

    def recordings(self, path: Path, options: ReadOptions) -> Iterator[Recording | Malformed]:
        files = mcap_file.candidates(path)
        for name, file in zip(mcap_file.recording_names(path, files), files, strict=True):
            try:
                yield finished(assemble(name, _read(file), options), options)
            except EdreamError as error:
                yield Malformed(name, str(error) if str(file) in str(error) else f"{file}: {error}")


def _read(file: Path) -> Signals:
    signals = Signals()
    decoders = _Decoders(file)
    for message in mcap_file.messages(file, signals.metadata):
        _add(signals, message, decoders)
    return signals


class _Decoders:
    """Decoders of one file's schemas, made on first use."""

    def __init__(self, file: Path) -> None:
        self.file = file
        self._factory = DecoderFactory()
        self._made: dict[int, Callable[[bytes], Any] | None] = {}

    def decode(self, message: Stamped) -> Any:
        """The message's fields.

        Raises:
            EdreamError: its schema or bytes are damaged.
        """
        schema = message.schema
        try:
            if id(schema) not in self._made:
                self._made[id(schema)] = self._factory.decoder_for(message.encoding, schema)
            decoder = self._made[id(schema)]
            return decoder(message.data) if decoder else None
        except DECODE_ERRORS as error:
            named = schema.name if schema else "no schema"
            raise EdreamError(
                f"{self.file} is damaged: a message of {message.topic} ({named}) cannot be decoded: {one_line(error)}."
            ) from error


def _kind(message: Stamped) -> str:
    return message.schema.name.replace("/msg/", "/") if message.schema else ""


def _add(signals: Signals, message: Stamped, decoders: _Decoders) -> None:
    kind = _kind(message)
    if kind == "sensor_msgs/JointState":
        body = decoders.decode(message)
        if body is not None:
            _add_joints(signals, message, body)
    elif kind == "std_msgs/Bool":
        body = decoders.decode(message)
        signals.flags.setdefault(message.topic, []).append((0, message.publish_time, message.log_time, bool(body.data)))
    elif kind in ("std_msgs/Float64", "std_msgs/Float32"):
        signals.numbers.setdefault(message.topic, []).append(float(decoders.decode(message).data))
    elif kind == "sensor_msgs/BatteryState":
        signals.numbers.setdefault(message.topic, []).append(float(decoders.decode(message).voltage))


def _add_joints(signals: Signals, message: Stamped, body: Any) -> None:
    try:
        header = int(body.header.stamp.sec) * 1_000_000_000 + int(body.header.stamp.nanosec)
        values = (list(body.position), list(body.velocity), list(body.effort))
        names = tuple(body.name)
    except (AttributeError, TypeError) as error:
        raise EdreamError(f"a message of {message.topic} is no sensor_msgs/JointState: {one_line(error)}.") from error
    signals.joints.setdefault(message.topic, JointTopic()).add((header, message.publish_time, message.log_time), names, values)


ENTRY = McapRos2()
