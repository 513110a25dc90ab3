"""MCAP recordings of ROS 2 topics (CDR): sensor_msgs/JointState, a torque switch, voltages, images."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from edream.core.episode import Recording
from edream.core.errors import EdreamError
from edream.core.format import Format, Malformed, ReadOptions
from edream.ingest import mcap_file
from edream.ingest.border import finished, one_line
from edream.ingest.mcap_file import Stamped
from edream.ingest.ros2 import Cameras, Decoders, kind_of
from edream.ingest.signals import JointTopic, Signals, assemble


class McapRos2(Format):
    """Joint states on a measured and a commanded topic, each on its own clock; images as sensor_msgs/CompressedImage or Image.

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
    decoders = Decoders(file)
    cameras = Cameras(decoders)
    for message in mcap_file.messages(file, signals.metadata):
        if not cameras.add(message):
            _add(signals, message, decoders)
    signals.videos.update(cameras.videos())
    return signals


def _add(signals: Signals, message: Stamped, decoders: Decoders) -> None:
    kind = kind_of(message)
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
