"""ROS 2 recordings with cameras and with one joint topic an arm."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from mcap_ros2.writer import Writer

from edream.core.episode import Recording
from edream.core.format import Malformed, ReadOptions
from edream.ingest.recordings import read_recordings
from tests.recordings import JOINT_STATE, jpeg

LINE = "=" * 80 + "\n"
STAMP = "MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec"
HEADER = f"{LINE}MSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n{LINE}{STAMP}"
COMPRESSED = f"std_msgs/Header header\nstring format\nuint8[] data\n{HEADER}"
PIXELS = "uint32 height\nuint32 width\nstring encoding\nuint8 is_bigendian\nuint32 step\nuint8[] data"
RAW = f"std_msgs/Header header\n{PIXELS}\n{HEADER}"
INFO = f"std_msgs/Header header\nuint32 height\nuint32 width\nstring distortion_model\nfloat64[] d\nfloat64[9] k\n{HEADER}"
K = [500.0, 0.0, 10.0, 0.0, 510.0, 8.0, 0.0, 0.0, 1.0]


def header(time: int) -> dict:
    return {"stamp": {"sec": time // 10**9, "nanosec": time % 10**9}, "frame_id": ""}


def pixels(row: int) -> np.ndarray:
    image = np.zeros((4, 5, 3), np.uint8)
    image[..., 0], image[..., 1], image[..., 2] = 200, row, 7
    return image


def read(path: Path, **options) -> Recording | Malformed:
    found: Iterator = read_recordings(path, ReadOptions(**options))
    return next(iter(found))


@pytest.fixture
def cameras(tmp_path: Path) -> Path:
    with (tmp_path / "cameras.mcap").open("wb") as stream:
        writer = Writer(stream)
        joints = writer.register_msgdef("sensor_msgs/msg/JointState", JOINT_STATE)
        compressed = writer.register_msgdef("sensor_msgs/msg/CompressedImage", COMPRESSED)
        raw = writer.register_msgdef("sensor_msgs/msg/Image", RAW)
        info = writer.register_msgdef("sensor_msgs/msg/CameraInfo", INFO)
        for row in range(12):
            time = 1_700_000_000_000_000_000 + row * 20_000_000
            for topic in ("/joint_states", "/joint_commands"):
                body = {"header": header(time), "name": ["a"], "position": [0.1 * row], "velocity": [], "effort": []}
                writer.write_message(topic, joints, body, log_time=time, publish_time=time)
            picture = {"header": header(time + 5_000_000), "format": "jpeg", "data": jpeg(row)}
            writer.write_message("/camera/wrist/image_raw/compressed", compressed, picture, log_time=time, publish_time=time)
            depth = picture | {"format": "16UC1; compressedDepth png", "data": b"\0" * 30}
            writer.write_message("/camera/depth/image_raw/compressedDepth", compressed, depth, log_time=time, publish_time=time)
            rows = np.zeros((4, 16), np.uint8)
            rows[:, :15] = pixels(row)[..., ::-1].reshape(4, 15)
            body = {"header": header(time), "height": 4, "width": 5, "encoding": "bgr8", "is_bigendian": 0, "step": 16}
            writer.write_message("/camera/top/image_raw", raw, body | {"data": rows.tobytes()}, log_time=time, publish_time=time)
            body = {"header": header(time), "height": 4, "width": 5, "distortion_model": "", "d": [], "k": K}
            writer.write_message("/camera/top/camera_info", info, body, log_time=time, publish_time=time)
        writer.finish()
    return tmp_path


def test_compressed_and_raw_camera_topics_become_videos_on_the_clock_of_the_joints(cameras: Path) -> None:
    found = read(cameras)
    assert isinstance(found, Recording), found
    assert set(found.videos) == {"wrist", "top"}
    np.testing.assert_allclose(found.videos["wrist"].times, 0.005 + 0.02 * np.arange(12), atol=1e-9)
    top = list(found.videos["top"].frames())
    assert len(top) == 12
    np.testing.assert_array_equal(top[7], pixels(7))
    assert len(list(found.videos["wrist"].frames())) == 12


def test_camera_info_gives_the_pinhole_matrix(cameras: Path) -> None:
    found = read(cameras)
    assert isinstance(found, Recording)
    np.testing.assert_array_equal(found.videos["top"].intrinsics, np.reshape(K, (3, 3)))
    assert found.videos["wrist"].intrinsics is None


@pytest.fixture
def two_arms(tmp_path: Path) -> Path:
    with (tmp_path / "arms.mcap").open("wb") as stream:
        writer = Writer(stream)
        schema = writer.register_msgdef("sensor_msgs/msg/JointState", JOINT_STATE)
        for row in range(40):
            for arm, late in (("left", 0), ("right", 7_000_000)):
                time = 1_700_000_000_000_000_000 + row * 20_000_000 + late
                for topic, value in (("states", 1e-9 * (time - 1_700_000_000_000_000_000)), ("commands", float(row))):
                    body = {"header": header(time), "name": [f"{arm}_joint"], "position": [value], "velocity": [], "effort": []}
                    writer.write_message(f"/{arm}/joint_{topic}", schema, body, log_time=time, publish_time=time)
        writer.finish()
    return tmp_path


def test_topics_of_two_arms_are_merged_where_the_config_names_both(two_arms: Path) -> None:
    found = read(
        two_arms,
        position=("/left/joint_states", "/right/joint_states"),
        command=("/left/joint_commands", "/right/joint_commands"),
    )
    assert isinstance(found, Recording), found
    assert found.channels == ("left_joint", "right_joint")
    assert found.times[0] == 0.0
    # both arms move by one radian a second on one clock, so interpolated they agree
    np.testing.assert_allclose(found.position[:, 0], found.position[:, 1], atol=1e-9)
    np.testing.assert_allclose(found.position[:, 0], found.times + 0.02, atol=1e-9)
    at = np.searchsorted(found.command_times, 0.1 + 1e-6, side="right") - 1
    assert found.command[at].tolist() == [6.0, 5.0]
    assert "interpolated" in found.notes["merged"]


def test_topics_of_two_arms_without_names_are_refused_in_a_sentence_that_says_what_to_write(two_arms: Path) -> None:
    found = read(two_arms)
    assert isinstance(found, Malformed)
    assert "ingest.position=[/topic]" in found.reason
