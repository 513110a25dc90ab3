"""Foxglove messages in MCAP files, protobuf or JSON, as signals of a recording."""

import base64
import binascii
import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from google.protobuf.message import DecodeError
from mcap.exceptions import McapError
from mcap_protobuf.decoder import DecoderFactory

from edream.core.episode import Video
from edream.core.errors import EdreamError
from edream.ingest import mcap_file
from edream.ingest.border import one_line
from edream.ingest.mcap_file import Stamped
from edream.ingest.signals import JointTopic, Signals
from edream.ingest.video import EncodedFrames, image_size

JOINTS = ("foxglove.JointStates", "JointStates")
JOINT_FIELDS = ("position", "velocity", "effort")
IMAGE, CALIBRATION = ("foxglove.CompressedImage", "CompressedImage"), ("foxglove.CameraCalibration", "CameraCalibration")
DECODE_ERRORS = (McapError, DecodeError, ValueError, TypeError, LookupError, AttributeError, RecursionError, binascii.Error)


class Decoders:
    """Decoders of one file's schemas; every message comes out as an object or mapping with the schema's fields."""

    def __init__(self, file: Path) -> None:
        self.file = file
        self._factory = DecoderFactory()
        self._made: dict[int, Callable[[bytes], Any] | None] = {}

    def decode(self, message: Stamped) -> Any:
        """The message's fields, or None where its encoding is another.

        Raises:
            EdreamError: its schema or bytes are damaged.
        """
        try:
            if message.encoding == "json":
                return json.loads(message.data)
            key = id(message.schema)
            if key not in self._made:
                self._made[key] = self._factory.decoder_for(message.encoding, message.schema)
            decoder = self._made[key]
            return decoder(message.data) if decoder else None
        except DECODE_ERRORS as error:
            raise damaged(self.file, message, error) from error


def damaged(file: Path, message: Stamped, error: Exception) -> EdreamError:
    """The sentence for a message that cannot be decoded."""
    named = message.schema.name if message.schema else "no schema"
    return EdreamError(f"{file} is damaged: a message of {message.topic} ({named}) cannot be decoded: {one_line(error)}.")


@dataclass
class Camera:
    """Stamps [ns] and first image of one image topic; what calibrates it."""

    stamps: list[tuple[int, int, int]] = field(default_factory=list)
    size: tuple[int, int] = (0, 0)
    intrinsics: np.ndarray | None = None
    poses: list[np.ndarray] = field(default_factory=list)


def read_signals(file: Path) -> Signals:
    """Joint states, switches, images and conditions of one file, images by reference.

    Raises:
        EdreamError: the file or a message in it is damaged.
    """
    signals, cameras, decoders = Signals(), {}, Decoders(file)
    for message in mcap_file.messages(file, signals.metadata):
        try:
            _add(signals, cameras, message, decoders)
        except DECODE_ERRORS as error:
            raise damaged(file, message, error) from error
    for name, camera in cameras.items():
        if camera.stamps:
            signals.videos[name] = _video(file, name, camera)
    return signals


def _add(signals: Signals, cameras: dict[str, Camera], message: Stamped, decoders: Decoders) -> None:
    kind = message.schema.name if message.schema else ""
    last = message.topic.rstrip("/").split("/")[-1]
    if kind in JOINTS:
        body = decoders.decode(message)
        stamp = (header_time(get(body, "timestamp")), message.publish_time, message.log_time)
        names, values = joint_values(body)
        signals.joints.setdefault(message.topic, JointTopic()).add(stamp, names, values)
    elif kind in IMAGE:
        body = decoders.decode(message)
        camera = cameras.setdefault(camera_name(message.topic), Camera())
        if not camera.stamps:
            camera.size = image_size(image_bytes(body), f"{decoders.file}, topic {message.topic}")
        camera.stamps.append((header_time(get(body, "timestamp")), message.publish_time, message.log_time))
    elif kind in CALIBRATION:
        matrix = np.array(list(get(decoders.decode(message), "K") or ()), dtype=np.float64)
        if matrix.size == 9 and matrix[0] != 0:
            cameras.setdefault(camera_name(message.topic), Camera()).intrinsics = matrix.reshape(3, 3)
    elif kind == "edream.CameraPose":
        matrix = np.array(get(decoders.decode(message), "matrix"), dtype=np.float64).reshape(4, 4)
        cameras.setdefault(camera_name(message.topic), Camera()).poses.append(matrix)
    elif message.encoding == "json" and last in ("torque_enable", "torque_enabled", "enabled", "enable"):
        body = decoders.decode(message)
        value = next((body[key] for key in ("enabled", "data", "value") if key in body), None)
        signals.flags.setdefault(message.topic, []).append((0, message.publish_time, message.log_time, bool(value)))
    elif message.encoding == "json" and "voltage" in last:
        body = decoders.decode(message)
        value = next((body[key] for key in ("voltage", "data", "value") if key in body), float("nan"))
        signals.numbers.setdefault(message.topic, []).append(float(value))


def get(body: Any, name: str) -> Any:
    """A field of a protobuf message or of a JSON object."""
    return body.get(name) if isinstance(body, dict) else getattr(body, name)


def joint_values(body: Any) -> tuple[tuple[str, ...], tuple[list[float], list[float], list[float]]]:
    """Joint names of a JointStates message, and those of their positions, velocities and efforts that are set."""
    if isinstance(body, dict):
        joints = list(body.get("joints") or ())
        rows = [[float(joint[what]) for joint in joints if joint.get(what) is not None] for what in JOINT_FIELDS]
        return tuple(str(joint["name"]) for joint in joints), (rows[0], rows[1], rows[2])
    # every row of every recording passes here: attributes spelled out are three times as fast as getattr
    joints = body.joints
    position = [joint.position for joint in joints if joint.HasField("position")]
    velocity = [joint.velocity for joint in joints if joint.HasField("velocity")]
    effort = [joint.effort for joint in joints if joint.HasField("effort")]
    return tuple(joint.name for joint in joints), (position, velocity, effort)


def header_time(stamp: Any) -> int:
    """A Foxglove timestamp [ns]: protobuf `seconds`/`nanos`, JSON `sec`/`nsec`; 0 where there is none."""
    if stamp is None:
        return 0
    if isinstance(stamp, dict):
        return int(stamp.get("sec", 0)) * 1_000_000_000 + int(stamp.get("nsec", stamp.get("nanosec", 0)))
    return int(stamp.seconds) * 1_000_000_000 + int(stamp.nanos)


def image_bytes(body: Any) -> bytes:
    """The encoded image of a CompressedImage; base64 in JSON."""
    data = get(body, "data")
    return base64.b64decode(data, validate=True) if isinstance(data, str) else bytes(data)


def camera_name(topic: str) -> str:
    """A camera's name from its topic: `/camera/NAME/image` -> NAME."""
    parts = [part for part in topic.split("/") if part]
    while len(parts) > 1 and parts[-1].lower() in (
        "image",
        "compressed",
        "image_raw",
        "calibration",
        "camera_info",
        "pose",
        "color",
        "image_compressed",
    ):
        parts.pop()
    return "_".join(parts[1:] if len(parts) > 1 and parts[0] in ("camera", "cameras") else parts) or "camera"


@dataclass(frozen=True)
class McapImages:
    """Encoded images of one camera in an MCAP file."""

    file: Path
    name: str

    def __call__(self) -> Iterator[bytes]:
        decoders = Decoders(self.file)
        for message in mcap_file.messages(self.file):
            if message.schema and message.schema.name in IMAGE and camera_name(message.topic) == self.name:
                try:
                    yield image_bytes(decoders.decode(message))
                except DECODE_ERRORS as error:
                    raise damaged(self.file, message, error) from error


def _video(file: Path, name: str, camera: Camera) -> Video:
    """A video whose times are still stamps (T, 3) [ns]."""
    poses = None if not camera.poses else camera.poses[0] if len(camera.poses) == 1 else np.array(camera.poses)
    frames = EncodedFrames(McapImages(file, name), f"{file}, camera {name!r}")
    return Video(np.array(camera.stamps, dtype=np.int64), *camera.size, frames, camera.intrinsics, poses)
