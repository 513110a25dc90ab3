"""Damaged files: whatever is cut or flipped, only a sentence may come out."""

import json
import shutil
import tempfile
from functools import cache
from pathlib import Path

import h5py
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from edream import catalog
from edream.core.errors import EdreamError
from edream.core.format import Format, Malformed, ReadOptions
from edream.ingest.findings import find
from edream.ingest.mapping import MappingConfig, map_recording
from tests.recordings import SAMPLES, make_sample

JOINTS = SAMPLES.names
DAMAGE = st.one_of(
    st.tuples(st.just("cut"), st.floats(0, 1), st.just(0)),
    st.tuples(st.just("flip"), st.floats(0, 1), st.integers(1, 255)),
    st.tuples(st.just("fill"), st.floats(0, 1), st.integers(0, 255)),
)


@cache
def sample(name: str) -> Path:
    """One valid sample of a format, made once."""
    return make_sample(name, Path(tempfile.mkdtemp(prefix="fuzz")))


def damaged(data: bytes, how: str, where: float, value: int) -> bytes:
    at = min(int(where * len(data)), len(data) - 1)
    if how == "cut":
        return data[:at]
    if how == "flip":
        return data[:at] + bytes([data[at] ^ value]) + data[at + 1 :]
    return data[:at] + bytes([value]) * min(8, len(data) - at) + data[at + 8 :]


def read_all(entry: Format, path: Path) -> None:
    """Everything that ingest does with a path, images included."""
    entry.recognise(path)
    options = ReadOptions(fps=50.0) if entry.name == "rlds" else ReadOptions()
    for one in entry.recordings(path, options):
        if isinstance(one, Malformed):
            assert one.reason
            continue
        try:
            find(map_recording(one, JOINTS, MappingConfig(by="order")))
            for video in one.videos.values():
                for image in video.frames():
                    assert image.shape[2] == 3
        except EdreamError:
            continue


@pytest.mark.parametrize("name", catalog.names("formats"))
@settings(max_examples=60, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
@given(damage=st.lists(DAMAGE, min_size=1, max_size=3), which=st.integers(0, 20))
def test_a_damaged_file_ends_in_a_sentence(name: str, damage: list[tuple[str, float, int]], which: int) -> None:
    entry = catalog.load("formats", name, Format)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(shutil.copytree(sample(name), Path(folder) / "set"))
        files = sorted(file for file in path.rglob("*") if file.is_file())
        victim = files[which % len(files)]
        data = victim.read_bytes()
        for how, where, value in damage:
            data = damaged(data, how, where, value) if data else data
        victim.write_bytes(data)
        try:
            read_all(entry, path)
        except EdreamError as error:
            assert str(error)


def test_a_template_that_fills_to_a_name_no_file_can_have_is_a_sentence(tmp_path: Path) -> None:
    path = make_sample("lerobot_v21", tmp_path)
    info = path / "meta" / "info.json"
    info.write_text(json.dumps(json.loads(info.read_text()) | {"data_path": "data/" + "long" * 100 + ".parquet"}))
    found = list(catalog.load("formats", "lerobot_v21", Format).recordings(path, ReadOptions()))
    assert found and all(isinstance(one, Malformed) and "no usable path" in one.reason for one in found)


def test_a_camera_that_leads_nowhere_is_a_sentence(tmp_path: Path) -> None:
    path = make_sample("aloha_hdf5", tmp_path)
    for file in path.rglob("*.hdf5"):
        with h5py.File(file, "a") as opened:
            opened["observations/images/lost"] = h5py.SoftLink("/nowhere")
    found = list(catalog.load("formats", "aloha_hdf5", Format).recordings(path, ReadOptions()))
    assert found and all(isinstance(one, Malformed) and "lost" in one.reason for one in found)


def test_an_episode_number_beyond_what_a_double_holds_is_a_sentence(tmp_path: Path) -> None:
    path = make_sample("lerobot_v3", tmp_path)
    file = next((path / "data").rglob("*.parquet"))
    table = pq.read_table(file)
    huge = pa.array([2**54 + 1] * len(table), pa.int64())
    pq.write_table(table.set_column(table.schema.get_field_index("episode_index"), "episode_index", huge), file)
    found = list(catalog.load("formats", "lerobot_v3", Format).recordings(path, ReadOptions()))
    assert found and all(isinstance(one, Malformed) for one in found)
