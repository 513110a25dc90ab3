"""Small valid recordings in every format, built without edream's own writers where it has none."""

import csv
import hashlib
import json
import struct
from pathlib import Path
from types import SimpleNamespace

import cv2
import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from mcap.writer import CompressionType, Writer
from mcap_ros2.writer import Writer as Ros2Writer

from edream.core.episode import Episode, Recording
from edream.formats.lerobot_v3 import ENTRY as LEROBOT_V3
from edream.ingest.episode_file import write_episode
from edream.ingest.tfrecord import masked

ROWS, STEP = 25, 0.02
JOINT_STATE = """std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec"""


def _numbers(phase: float) -> np.ndarray:
    time = np.arange(ROWS) * STEP
    return np.stack([np.sin(time + phase), 0.5 * np.cos(2 * time + phase)], axis=1).astype(np.float32).astype(float)


SAMPLES = SimpleNamespace(times=np.arange(ROWS) * STEP, position=_numbers(0.0), command=_numbers(0.3), names=("shoulder", "elbow"))


def make_sample(name: str, folder: Path) -> Path:
    """A folder with one or two recordings of `SAMPLES` in the format `name`."""
    path = folder / f"sample_{name}"
    path.mkdir()
    {
        "aloha_hdf5": _aloha,
        "edream_mcap": _edream_mcap,
        "lerobot_v21": _lerobot_v21,
        "lerobot_v3": _lerobot_v3,
        "mcap_foxglove": _foxglove,
        "mcap_ros2": _ros2,
        "rlds": _rlds,
        "table": _table,
    }[name](path)
    return path


def jpeg(seed: int) -> bytes:
    image = np.random.default_rng(seed).integers(0, 255, (16, 16, 3), dtype=np.uint8)
    return cv2.imencode(".jpg", image)[1].tobytes()


def sample_recording(name: str = "episode_000000") -> Recording:
    times = SAMPLES.times.astype(np.float32).astype(float)
    return Recording(name, times, SAMPLES.names, SAMPLES.position, times, SAMPLES.names, SAMPLES.command)


def sample_episode(name: str = "wave") -> Episode:
    return Episode(name, SAMPLES.names, SAMPLES.times, SAMPLES.position, SAMPLES.times, SAMPLES.command)


def _aloha(path: Path) -> None:
    with h5py.File(path / "episode_0.hdf5", "w") as out:
        out.attrs["sim"] = False
        out["action"] = SAMPLES.command.astype(np.float32)
        out["observations/qpos"] = SAMPLES.position.astype(np.float32)
        out["timestamps"] = SAMPLES.times
        rows = [np.frombuffer(jpeg(row), np.uint8) for row in range(ROWS)]
        padded = np.zeros((ROWS, max(map(len, rows))), np.uint8)
        for row, data in enumerate(rows):
            padded[row, : len(data)] = data
        out["observations/images/cam_high"] = padded


def _edream_mcap(path: Path) -> None:
    write_episode(sample_episode(), path / "wave.mcap")


def _lerobot_v3(path: Path) -> None:
    LEROBOT_V3.write([sample_recording()], path)


def _lerobot_v21(path: Path) -> None:
    names = list(SAMPLES.names)
    features = {key: {"dtype": "float32", "shape": [2], "names": {"motors": names}} for key in ("observation.state", "action")}
    info = {"codebase_version": "v2.1", "robot_type": "two", "fps": 50, "chunks_size": 1000, "features": features}
    info["data_path"] = "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet"
    (path / "meta").mkdir()
    (path / "meta/info.json").write_text(json.dumps(info))
    (path / "meta/episodes.jsonl").write_text(json.dumps({"episode_index": 0, "tasks": ["wave"], "length": ROWS}) + "\n")
    (path / "data/chunk-000").mkdir(parents=True)
    arrays = {"observation.state": SAMPLES.position, "action": SAMPLES.command}
    columns = {key: pa.array(array.tolist(), pa.list_(pa.float32())) for key, array in arrays.items()}
    columns |= {"timestamp": pa.array(SAMPLES.times, pa.float32()), "episode_index": pa.array([0] * ROWS)}
    pq.write_table(pa.table(columns), path / "data/chunk-000/episode_000000.parquet")


def _ros2(path: Path) -> None:
    with (path / "wave.mcap").open("wb") as stream:
        writer = Ros2Writer(stream, compression=CompressionType.LZ4)
        schema = writer.register_msgdef("sensor_msgs/msg/JointState", JOINT_STATE)
        switch = writer.register_msgdef("std_msgs/msg/Bool", "bool data")
        for row, time in enumerate(np.round(SAMPLES.times * 1e9).astype(int).tolist()):
            time += 1_700_000_000_000_000_000
            stamp = {"sec": time // 10**9, "nanosec": time % 10**9}
            for topic, values in (("/joint_states", SAMPLES.position), ("/joint_commands", SAMPLES.command)):
                body = {
                    "header": {"stamp": stamp, "frame_id": ""},
                    "name": list(SAMPLES.names),
                    "position": values[row].tolist(),
                    "velocity": [],
                    "effort": [],
                }
                writer.write_message(topic, schema, body, log_time=time, publish_time=time)
            writer.write_message("/torque_enable", switch, {"data": row < 20}, log_time=time, publish_time=time)
        writer.finish()


def _foxglove(path: Path) -> None:
    with (path / "wave.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="", library="test")
        schema = writer.register_schema("foxglove.JointStates", "jsonschema", b"{}")
        topics = (
            (writer.register_channel(topic, "json", schema), values)
            for topic, values in (("/state", SAMPLES.position), ("/command", SAMPLES.command))
        )
        for channel, values in topics:
            for row, time in enumerate(np.round(SAMPLES.times * 1e9).astype(int).tolist()):
                joints = [
                    {"name": name, "position": value} for name, value in zip(SAMPLES.names, values[row].tolist(), strict=True)
                ]
                body = {"timestamp": {"sec": time // 10**9, "nsec": time % 10**9}, "joints": joints}
                writer.add_message(channel, time, json.dumps(body).encode(), time)
        writer.finish()


def _varint(value: int) -> bytes:
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*out, value])


def _field(number: int, data: bytes) -> bytes:
    return _varint(number << 3 | 2) + _varint(len(data)) + data


def _rlds(path: Path) -> None:
    floats = {"steps/observation/state": SAMPLES.position, "steps/action": SAMPLES.command}
    features = {key: _field(2, _field(1, value.astype("<f4").tobytes())) for key, value in floats.items()}
    features["steps/is_first"] = _field(3, _field(1, b"\x01" + b"\x00" * (ROWS - 1)))
    features["steps/observation/image_0"] = _field(1, b"".join(_field(1, jpeg(row)) for row in range(ROWS)))
    body = b"".join(_field(1, _field(1, key.encode()) + _field(2, value)) for key, value in features.items())
    example = _field(1, body)
    length = struct.pack("<Q", len(example))
    record = length + struct.pack("<I", masked(length)) + example + struct.pack("<I", 0)
    (path / "data.tfrecord-00000-of-00001").write_bytes(record)
    assert hashlib.sha256(example).hexdigest()


def _table(path: Path) -> None:
    with (path / "wave.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["time", *(f"command_{name}" for name in SAMPLES.names), *(f"position_{name}" for name in SAMPLES.names)])
        for row in range(ROWS):
            writer.writerow(
                [
                    repr(SAMPLES.times[row].item()),
                    *map(repr, SAMPLES.command[row].tolist()),
                    *map(repr, SAMPLES.position[row].tolist()),
                ]
            )
