"""Episodes on disk: one MCAP file each, in Foxglove's well-known schemas, the same bytes for the same episode."""

import heapq
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from google.protobuf.timestamp_pb2 import Timestamp
from mcap.writer import CompressionType, Writer
from mcap_protobuf.schema import build_file_descriptor_set
from scipy.spatial.transform import Rotation

from edream.core.episode import Episode, Video
from edream.core.errors import EdreamError
from edream.ingest.video import EncodedFrames, encode_image, image_kind

PROFILE = "edream"
STATES, COMMANDS, SWITCH = "/joint_states", "/joint_commands", "/torque_enable"
SIGNAL = "/signal"
CHUNK_BYTES = 4 * 2**20
SWITCH_SCHEMA = {"title": "edream.TorqueEnable", "type": "object", "properties": {"enabled": {"type": "boolean"}}}
POSE_SCHEMA = {
    "title": "edream.CameraPose",
    "description": "Pose of the camera in the robot's base frame, 4 x 4, row by row",
    "type": "object",
    "properties": {"matrix": {"type": "array", "items": {"type": "number"}}},
}
Row = tuple[int, int, int, bytes]  # log time [ns], rank among equals, channel, message


def write_episode(
    episode: Episode,
    path: Path,
    provenance: Mapping[str, str] | None = None,
    config: Mapping[str, Any] | None = None,
    images: str = "png",
) -> None:
    """Write one episode as one MCAP file that opens in Foxglove and reads back exactly.

    Topics: `/joint_states` and `/joint_commands` (foxglove.JointStates), `/torque_enable` at each change, `/signal/NAME` for
    numbers of no joint (foxglove.JointStates too, a position for each), and for each camera
    `/camera/NAME/image` (foxglove.CompressedImage; JPEG and PNG of the recording are passed on untouched), `/calibration`,
    `/pose`. Clocks are kept to the nanosecond. Nothing in the file depends on when or where it is written.

    Args:
        episode: what to write.
        path: the new file.
        provenance: where it comes from, as text.
        config: the resolved configuration it was made with; attached as JSON.
        images: how other images are encoded, "png" (lossless) or "jpeg".

    Raises:
        EdreamError: `path` exists, or an image cannot be read.
    """
    if path.exists():
        raise EdreamError(f"{path} exists already; an episode file is never overwritten.")
    start = max(0, -int(nanoseconds(min(episode.command_times[0], *(video.times[0] for video in episode.videos.values()), 0.0))))
    # PNG and JPEG do not shrink further
    compression = CompressionType.NONE if episode.videos else CompressionType.ZSTD
    try:
        with path.open("xb") as stream:
            writer = Writer(stream, chunk_size=CHUNK_BYTES, compression=compression)
            writer.start(profile=PROFILE, library="edream")
            streams = [*_joint_rows(writer, episode, start), *_camera_rows(writer, episode, start, images)]
            sequences: dict[int, int] = {}
            for time, _, channel, data in heapq.merge(*streams):
                sequences[channel] = sequences.get(channel, -1) + 1
                writer.add_message(channel, time, data, publish_time=time, sequence=sequences[channel])
            _facts(writer, episode, start, provenance or {}, config or {})
            writer.finish()
    except BaseException:
        path.unlink(missing_ok=True)
        raise


def write_commands(joints: tuple[str, ...], times: np.ndarray, command: np.ndarray, path: Path) -> None:
    """Write a motion that is yet to be recorded: `/joint_commands` alone, in the form of an episode's.

    Args:
        joints: names, (J,).
        times: seconds, (K,), from 0.
        command: positions [rad or m], (K, J).
        path: the new file.
    """
    with path.open("xb") as stream:
        writer = Writer(stream, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        writer.start(profile=PROFILE, library="edream")
        channel = _channel(writer, COMMANDS, _protobuf(writer, JointStates))
        for time, _, number, data in _states(channel, 0, nanoseconds(times), joints, (command, None, None)):
            writer.add_message(number, time, data, publish_time=time)
        writer.add_metadata("motion", {"joints": json.dumps(list(joints)), "seconds": repr(float(times[-1]))})
        about = b"Commands to play on the robot and record; rad (m for slides), seconds."
        writer.add_attachment(0, 0, "about.txt", "text/plain", about)
        writer.finish()


def nanoseconds(seconds: Any) -> Any:
    """Seconds as whole nanoseconds (an int64 array, or a number)."""
    return np.round(np.asarray(seconds, dtype=np.float64) * 1e9).astype(np.int64)


def _facts(writer: Writer, episode: Episode, start: int, provenance: Mapping[str, str], config: Mapping[str, Any]) -> None:
    # the writer leaves empty SummaryOffset groups, which readers refuse, unless there is metadata and an attachment
    about = {"name": episode.name, "joints": json.dumps(list(episode.joints)), "start_ns": str(start)}
    about |= {"signals": json.dumps(list(episode.signals))} if episode.signals else {}
    writer.add_metadata("episode", about | {"cameras": json.dumps(list(episode.videos))})
    writer.add_metadata("conditions", {name: repr(float(value)) for name, value in sorted(episode.conditions.items())})
    writer.add_metadata("notes", dict(sorted(episode.notes.items())))
    writer.add_metadata("provenance", dict(sorted(provenance.items())))
    text = json.dumps(config, sort_keys=True, indent=1, default=str)
    writer.add_attachment(create_time=0, log_time=start, name="config.json", media_type="application/json", data=text.encode())


def _joint_rows(writer: Writer, episode: Episode, start: int) -> Iterator[Iterator[Row]]:
    schema = _protobuf(writer, JointStates)
    commands = _channel(writer, COMMANDS, schema)
    states = _channel(writer, STATES, schema)
    yield _states(commands, 0, nanoseconds(episode.command_times) + start, episode.joints, (episode.command, None, None))
    if episode.enabled is not None:
        switch = writer.register_channel(SWITCH, "json", _json_schema(writer, SWITCH_SCHEMA))
        yield _switches(switch, episode, start)
    yield _states(
        states, 2, nanoseconds(episode.times) + start, episode.joints, (episode.position, episode.velocity, episode.effort)
    )
    for name, numbers in episode.signals.items():
        channel = _channel(writer, f"{SIGNAL}/{name}", schema)
        yield _states(channel, 3, nanoseconds(episode.times) + start, columns_of(numbers), (numbers, None, None))


def columns_of(numbers: np.ndarray) -> tuple[str, ...]:
    """Names of a signal's columns in an episode file: their places."""
    return tuple(map(str, range(numbers.shape[1])))


def _states(
    channel: int,
    rank: int,
    times: np.ndarray,
    joints: tuple[str, ...],
    values: tuple[np.ndarray, np.ndarray | None, np.ndarray | None],
) -> Iterator[Row]:
    names = ("position", "velocity", "effort")
    kept = [(name, array.tolist()) for name, array in zip(names, values, strict=True) if array is not None]
    for row, time in enumerate(times.tolist()):
        message = JointStates(timestamp=_timestamp(time))
        for column, joint in enumerate(joints):
            message.joints.add(name=joint, **{name: array[row][column] for name, array in kept})
        yield time, rank, channel, message.SerializeToString(deterministic=True)


def _switches(channel: int, episode: Episode, start: int) -> Iterator[Row]:
    assert episode.enabled is not None
    changed = np.flatnonzero(np.diff(episode.enabled.astype(np.int8), prepend=-1))
    for row in changed:
        data = json.dumps({"enabled": bool(episode.enabled[row])}).encode()
        yield int(nanoseconds(episode.command_times[row])) + start, 1, channel, data


def _camera_rows(writer: Writer, episode: Episode, start: int, images: str) -> Iterator[Iterator[Row]]:
    if not episode.videos:
        return
    schemas = {kind: _protobuf(writer, kind) for kind in (CompressedImage, CameraCalibration, FrameTransform)}
    pose_schema = _json_schema(writer, POSE_SCHEMA)
    transforms = _channel(writer, "/tf", schemas[FrameTransform])
    for number, (name, video) in enumerate(episode.videos.items()):
        topic, rank = f"/camera/{name}", 4 * number + 3
        times = (nanoseconds(video.times) + start).tolist()
        calibration = _channel(writer, f"{topic}/calibration", schemas[CameraCalibration])
        image = _channel(writer, f"{topic}/image", schemas[CompressedImage])
        yield iter([(times[0], rank, calibration, _calibration(name, video, times[0]))])
        if video.extrinsics is not None:
            poses = video.extrinsics[None] if video.extrinsics.ndim == 2 else video.extrinsics
            exact = writer.register_channel(f"{topic}/pose", "json", pose_schema)
            yield _poses(exact, rank + 1, times, poses)
            yield _transforms(transforms, rank + 2, times, poses, name)
        yield _images(image, rank + 3, times, name, video, episode.name, images)


def _images(channel: int, rank: int, times: list[int], name: str, video: Video, episode: str, images: str) -> Iterator[Row]:
    count = 0
    for data in _encoded(video, images):
        if count == len(times):
            raise EdreamError(f"Episode {episode!r}: camera {name!r} has more images than its {len(times)} times.")
        message = CompressedImage(timestamp=_timestamp(times[count]), frame_id=name, data=data, format=image_kind(data) or images)
        yield times[count], rank, channel, message.SerializeToString(deterministic=True)
        count += 1
    if count < len(times):
        raise EdreamError(f"Episode {episode!r}: camera {name!r} has {count} images for {len(times)} times.")


def _encoded(video: Video, images: str) -> Iterator[bytes]:
    if isinstance(video.frames, EncodedFrames) and not video.frames.swap:
        yield from video.frames.encoded()
    else:
        for image in video.frames():
            yield encode_image(image, images)


def _calibration(name: str, video: Video, time: int) -> bytes:
    message = CameraCalibration(timestamp=_timestamp(time), frame_id=name, width=video.width, height=video.height)
    # Foxglove's sign of an uncalibrated camera is K[0] == 0
    matrix = np.zeros((3, 3)) if video.intrinsics is None else video.intrinsics
    message.K.extend(matrix.ravel().tolist())
    message.P.extend(np.hstack([matrix, np.zeros((3, 1))]).ravel().tolist())
    message.R.extend(np.eye(3).ravel().tolist())
    return message.SerializeToString(deterministic=True)


def _poses(channel: int, rank: int, times: list[int], poses: np.ndarray) -> Iterator[Row]:
    for time, pose in zip(times, poses, strict=False):
        yield time, rank, channel, json.dumps({"matrix": pose.ravel().tolist()}).encode()


def _transforms(channel: int, rank: int, times: list[int], poses: np.ndarray, name: str) -> Iterator[Row]:
    for time, pose in zip(times, poses, strict=False):
        message = FrameTransform(timestamp=_timestamp(time), parent_frame_id="base", child_frame_id=name)
        message.translation.x, message.translation.y, message.translation.z = pose[:3, 3].tolist()
        turn = Rotation.from_matrix(pose[:3, :3]).as_quat().tolist()
        message.rotation.x, message.rotation.y, message.rotation.z, message.rotation.w = turn
        yield time, rank, channel, message.SerializeToString(deterministic=True)


def _timestamp(time: int) -> Timestamp:
    return Timestamp(seconds=time // 1_000_000_000, nanos=time % 1_000_000_000)


def _protobuf(writer: Writer, kind: Any) -> int:
    data = build_file_descriptor_set(kind).SerializeToString(deterministic=True)
    return writer.register_schema(kind.DESCRIPTOR.full_name, "protobuf", data)


def _json_schema(writer: Writer, schema: Mapping[str, Any]) -> int:
    return writer.register_schema(schema["title"], "jsonschema", json.dumps(schema).encode())


def _channel(writer: Writer, topic: str, schema: int) -> int:
    return writer.register_channel(topic, "protobuf", schema)
