"""ROS 2 messages in MCAP files: decoding CDR, and camera topics as videos."""

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8
from mcap.exceptions import McapError
from mcap_ros2._vendor.rosidl_adapter.parser import InvalidSpecification, InvalidValue
from mcap_ros2.decoder import DecoderFactory

from edream.core.episode import Video
from edream.core.errors import EdreamError
from edream.ingest import mcap_file
from edream.ingest.border import MAX_PIXELS, one_line
from edream.ingest.foxglove import Camera, camera_name
from edream.ingest.mcap_file import Stamped
from edream.ingest.video import EncodedFrames, image_size

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
COMPRESSED, RAW, INFO = "sensor_msgs/CompressedImage", "sensor_msgs/Image", "sensor_msgs/CameraInfo"
CHANNELS = {
    "rgb8": (3, (0, 1, 2)),
    "bgr8": (3, (2, 1, 0)),
    "rgba8": (4, (0, 1, 2)),
    "bgra8": (4, (2, 1, 0)),
    "mono8": (1, (0, 0, 0)),
}


def kind_of(message: Stamped) -> str:
    """The message type as `package/Name`."""
    return message.schema.name.replace("/msg/", "/") if message.schema else ""


class Decoders:
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


@dataclass
class Cameras:
    """The cameras of one file, met message by message; images stay in the file until they are asked for.

    Depth images are not read: encodings other than those of `CHANNELS`, and the transport `compressedDepth`, are left alone.

    Source: docs.ros.org sensor_msgs/msg/{CompressedImage,Image,CameraInfo}.
    """

    decoders: Decoders
    found: dict[str, Camera] = field(default_factory=dict)
    topics: dict[str, str] = field(default_factory=dict)

    def add(self, message: Stamped) -> bool:
        """Take note of a message of a camera; whether it was one.

        Raises:
            EdreamError: the message is damaged.
        """
        kind = kind_of(message)
        if kind not in (COMPRESSED, RAW, INFO):
            return False
        body = self.decoders.decode(message)
        name = camera_name(message.topic)
        where = f"{self.decoders.file}, topic {message.topic}"
        if kind == INFO:
            matrix = np.array(list(body.k), dtype=np.float64)
            if matrix.size == 9 and matrix[0] != 0:
                self.found.setdefault(name, Camera()).intrinsics = matrix.reshape(3, 3)
            return True
        if not _readable(kind, body) or self.topics.setdefault(name, message.topic) != message.topic:
            return True
        camera = self.found.setdefault(name, Camera())
        if not camera.stamps:
            camera.size = image_size(bytes(body.data), where) if kind == COMPRESSED else raw_image(body, where).shape[:2]
        stamp = int(body.header.stamp.sec) * 1_000_000_000 + int(body.header.stamp.nanosec)
        camera.stamps.append((stamp, message.publish_time, message.log_time))
        return True

    def videos(self) -> dict[str, Video]:
        """Camera name -> video, whose times are still stamps (T, 3) [ns]."""
        file, out = self.decoders.file, {}
        for name, camera in self.found.items():
            if camera.stamps:
                images = Images(file, self.topics[name])
                frames = images if images.raw() else EncodedFrames(images.encoded, f"{file}, camera {name!r}")
                out[name] = Video(np.array(camera.stamps, dtype=np.int64), *camera.size, frames, camera.intrinsics, None)
        return out


@dataclass(frozen=True)
class Images:
    """The images of one topic, read from the file when asked for."""

    file: Path
    topic: str

    def __call__(self) -> Iterator[UInt8[np.ndarray, "H W 3"]]:
        for body in self._bodies():
            yield raw_image(body, f"{self.file}, topic {self.topic}")

    def encoded(self) -> Iterator[bytes]:
        """Images as they are stored, JPEG or PNG."""
        for body in self._bodies():
            yield bytes(body.data)

    def raw(self) -> bool:
        """Whether they are pixels rather than JPEG or PNG."""
        return any(message.topic == self.topic and kind_of(message) == RAW for message in mcap_file.messages(self.file))

    def _bodies(self) -> Iterator[Any]:
        decoders = Decoders(self.file)
        for message in mcap_file.messages(self.file):
            if message.topic == self.topic:
                body = decoders.decode(message)
                if _readable(kind_of(message), body):
                    yield body


def _readable(kind: str, body: Any) -> bool:
    return str(body.encoding) in CHANNELS if kind == RAW else "compressedDepth" not in str(body.format)


def raw_image(body: Any, what: str) -> UInt8[np.ndarray, "H W 3"]:
    """A sensor_msgs/Image as RGB.

    Raises:
        EdreamError: its size does not fit its bytes.
    """
    channels, order = CHANNELS[str(body.encoding)]
    height, width, step = int(body.height), int(body.width), int(body.step)
    data = np.frombuffer(bytes(body.data), np.uint8)
    if not (0 < height * width <= MAX_PIXELS and step >= width * channels and data.size >= height * step):
        raise EdreamError(f"{what}: an image of {height} x {width} {body.encoding}, {step} bytes a row, has {data.size} bytes.")
    rows = data[: height * step].reshape(height, step)[:, : width * channels].reshape(height, width, channels)
    return np.ascontiguousarray(rows[:, :, list(order)])
