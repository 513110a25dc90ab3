import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from edream import kinds
from edream.core.errors import EdreamError
from edream.store import Store, publish, read_checked

MANIFEST = {"stage": "demo", "key": "00ff", "parents": {}, "made": {"at": "2026-01-01", "seconds": 1.0}, "fields": {}}
TABLE = pa.table(
    {
        "name": ["a", None, "c"],
        "x": pa.array([1.0, 2.0, None]),
        "flag": [True, False, None],
        "list": [[1.0, 2.0], [], None],
        "struct": [{"p": 1, "q": "u"}, None, {"p": 3, "q": None}],
        "code": pa.array(["u", "v", "u"]).dictionary_encode(),
    }
)


def store_with(tmp_path: Path, bundle: dict) -> Store:
    store = Store(tmp_path)
    store.publish(MANIFEST, bundle)
    return store


def test_every_kind_of_value_comes_back_as_it_was(tmp_path) -> None:
    bundle = {
        "t.parquet": TABLE,
        "a.json": {"b": [1, 2.5, None], "a": "ü"},
        "w.safetensors": {"x": np.arange(6, dtype=np.float32).reshape(2, 3)},
        "m.xml": "<mujoco/>",
        "p.png": b"\x89PNG",
        "deep/e.mcap": b"\x00\x01",
    }
    artifact = store_with(tmp_path, bundle).find("demo", "00ff")
    assert set(artifact) == set(bundle)
    assert artifact["t.parquet"].equals(TABLE)
    assert artifact["a.json"] == bundle["a.json"]
    np.testing.assert_array_equal(artifact["w.safetensors"]["x"], bundle["w.safetensors"]["x"])
    assert artifact["m.xml"] == "<mujoco/>" and artifact["deep/e.mcap"] == b"\x00\x01"


def test_a_table_means_the_same_however_it_is_chunked_and_compressed(tmp_path) -> None:
    import pyarrow.parquet as pq

    chunked = pa.concat_tables([TABLE.slice(0, 1), TABLE.slice(1)])
    kinds.write(TABLE, tmp_path / "one.parquet")
    pq.write_table(chunked, tmp_path / "two.parquet", compression="snappy", row_group_size=1)
    assert kinds.file_digest(tmp_path / "one.parquet") != kinds.file_digest(tmp_path / "two.parquet")
    assert kinds.digest(tmp_path / "one.parquet") == kinds.digest(tmp_path / "two.parquet")


@settings(max_examples=40, deadline=None)
@given(
    st.lists(st.one_of(st.none(), st.lists(st.one_of(st.none(), st.integers(-5, 5)), max_size=3)), min_size=1, max_size=4),
    st.data(),
)
def test_tables_that_differ_have_different_digests(tmp_path_factory, rows, data) -> None:
    other = data.draw(st.permutations(rows))
    folder = tmp_path_factory.mktemp("tables")
    kind = pa.list_(pa.int64())
    kinds.write(pa.table({"x": pa.array(rows, kind)}), folder / "a.parquet")
    kinds.write(pa.table({"x": pa.array(other, kind)}), folder / "b.parquet")
    assert (kinds.digest(folder / "a.parquet") == kinds.digest(folder / "b.parquet")) == (rows == list(other))


def test_a_column_name_or_type_changes_the_digest(tmp_path) -> None:
    tables = [pa.table({"x": pa.array([1, 2], kind)}) for kind in (pa.int64(), pa.int32(), pa.float64())] + [
        pa.table({"y": [1, 2]})
    ]
    digests = set()
    for i, table in enumerate(tables):
        kinds.write(table, tmp_path / f"{i}.parquet")
        digests.add(kinds.digest(tmp_path / f"{i}.parquet"))
    assert len(digests) == 4


def test_json_refuses_numbers_that_it_cannot_say_and_names_the_place() -> None:
    with pytest.raises(ValueError, match=r"\.fit\.x\[1\]"):
        kinds.canonical({"fit": {"x": [1.0, float("nan")]}})


def test_json_takes_dataclasses_numpy_and_tuples_apart() -> None:
    @dataclass(frozen=True)
    class Point:
        x: float

    value = {"p": Point(1.0), "n": np.float64(2.5), "a": np.arange(2), "t": (1, Path("m.xml"))}
    assert json.loads(kinds.canonical(value)) == {"p": {"x": 1.0}, "n": 2.5, "a": [0, 1], "t": [1, "m.xml"]}


def test_the_same_content_has_the_same_digest_under_any_key(tmp_path) -> None:
    one = publish(tmp_path / "demo" / "a", MANIFEST | {"key": "a"}, {"x.json": {"v": 1}})
    two = publish(tmp_path / "demo" / "b", MANIFEST | {"key": "b"}, {"x.json": {"v": 1}})
    assert one.digest == two.digest


def test_a_published_artifact_is_not_overwritten(tmp_path) -> None:
    publish(tmp_path / "demo" / "a", MANIFEST, {"x.txt": "first"})
    again = publish(tmp_path / "demo" / "a", MANIFEST, {"x.txt": "second"})
    assert again["x.txt"] == "first"
    assert [path.name for path in (tmp_path / "demo").iterdir()] == ["a"]


def test_a_users_own_file_is_copied_and_not_tied_to_the_artifact(tmp_path) -> None:
    mine = tmp_path / "mine.xml"
    mine.write_text("<mujoco/>")
    artifact = publish(tmp_path / "runs" / "demo" / "a", MANIFEST, {"model.xml": mine})
    mine.write_text("changed")
    assert artifact["model.xml"] == "<mujoco/>"


@pytest.mark.parametrize("name", ["../out.txt", "/out.txt", "a/../../out.txt", "manifest.json"])
def test_no_file_of_an_artifact_leaves_its_folder(tmp_path, name) -> None:
    with pytest.raises(ValueError, match="cannot be the name"):
        publish(tmp_path / "demo" / "a", MANIFEST, {name: "x"})
    assert not list(tmp_path.rglob("out.txt"))


def test_a_missing_file_is_named_with_the_files_there_are(tmp_path) -> None:
    artifact = store_with(tmp_path, {"model.xml": "x"}).find("demo", "00ff")
    with pytest.raises(EdreamError, match=r"modell\.xml.*Did you mean 'model\.xml'"):
        artifact["modell.xml"]


def test_a_manifest_with_any_field_changed_is_refused(tmp_path) -> None:
    store_with(tmp_path, {"x.txt": "x"})
    path = tmp_path / "demo" / "00ff" / "manifest.json"
    changed = json.loads(path.read_text()) | {"key": "0001"}
    path.chmod(0o644)
    path.write_bytes(kinds.canonical(changed))
    with pytest.raises(EdreamError, match="corrupt"):
        read_checked(path)


def test_a_file_added_to_an_artifact_is_noticed(tmp_path) -> None:
    store = store_with(tmp_path, {"x.txt": "x"})
    (tmp_path / "demo" / "00ff" / "stray.txt").write_text("")
    assert "stray.txt does not belong" in store.verify()[0]


def test_how_long_something_took_is_no_part_of_what_a_page_says(tmp_path) -> None:
    pages = {"fast": "<td><time>1.0</time></td>", "slow": "<td><time>99.5</time></td>", "other": "<td><time>1.0</time>!</td>"}
    for name, text in pages.items():
        kinds.write(text, tmp_path / f"{name}.html")
    fast, slow, other = (kinds.digest(tmp_path / f"{name}.html") for name in pages)
    assert fast == slow != other
