"""Damaged files that a user gives beside recordings: whatever is wrong in them is a sentence."""

import json
from pathlib import Path

import numpy as np
import pytest

from edream.core.camera import as_json, from_json
from edream.core.errors import EdreamError
from edream.core.scene import scene_from_json
from edream.ingest import mask_file
from edream.ingest.mask_file import read_masks
from edream.vision.scene_file import read_scene
from tests.fuzz import one
from tests.fuzz_files import FILES, make_files
from tests.rendering import camera_on


def test_masks_are_the_same_from_every_kind_of_file(tmp_path: Path) -> None:
    path = make_files("masks", tmp_path)
    found = {name: np.stack(read_masks(path, name)) for name in ("packed", "plain", "pictures", "lengths")}
    assert found["packed"][:, 2:5, 3:8].all() and found["packed"].sum() == 3 * 15
    assert np.array_equal(found["packed"], found["plain"]) and np.array_equal(found["packed"], found["pictures"])
    assert np.array_equal(found["packed"][0], found["lengths"][2]) and not found["lengths"][1].any()


def test_many_small_arrays_are_bounded_together(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    part = np.zeros((2, 8, 8), np.uint8)
    np.savez(tmp_path / "one.npz", part0=part, part1=part, part2=part, part3=part)
    assert len(mask_file.read_arrays(tmp_path / "one.npz")) == 4
    monkeypatch.setattr(mask_file, "MAX_BYTES", 3 * 128)
    with pytest.raises(EdreamError, match=r"part3\.npy is uint8 of shape"):
        mask_file.read_arrays(tmp_path / "one.npz")


@pytest.mark.parametrize("name", FILES)
def test_a_broken_file_is_read_or_refused_in_a_sentence(name: str, tmp_path: Path) -> None:
    sample = make_files(name, tmp_path)
    for seed in range(30 if name != "weights" else 12):
        one(name, sample, seed)


def test_what_fuzzing_found_in_scenes_cameras_and_masks_is_a_sentence(tmp_path: Path) -> None:
    (tmp_path / "scene.json").write_bytes(b'{"objects": "\xa9\xff"}')
    with pytest.raises(EdreamError, match="is no JSON"):
        read_scene(tmp_path / "scene.json")
    block = {"name": "block", "shape": "sphere", "size": [0.1], "colour": [1, 0, 0]}
    for size, times, words in (([float("nan")], [0.0], "sizes above 0"), ([0.1], [float("nan")], "is no scene")):
        track = {"times": times, "poses": [[0, 0, 0, 1, 0, 0, 0]]}
        with pytest.raises(EdreamError, match=words):
            scene_from_json({"objects": [block | {"size": size}], "tracks": {"one": {"block": track}}}, "here")
    with pytest.raises(EdreamError, match="'top' is unreadable"):
        from_json({"top": as_json({"top": camera_on()})["top"] | {"height": float("inf")}}, "here")
    np.savez_compressed(tmp_path / "one.npz", np.random.default_rng(0).integers(0, 2, (3, 9, 9)))
    data = bytearray((tmp_path / "one.npz").read_bytes())
    data[60:80] = b"\xff" * 20
    (tmp_path / "one.npz").write_bytes(data)
    with pytest.raises(EdreamError, match="cannot be read"):
        read_masks(tmp_path, "one")


@pytest.mark.parametrize(
    "change",
    [{"layers_per_block": 10**9}, {"block_out_channels": [65536, 65536]}, {"scaling_factor": 0}, {"down_block_types": ["Nothing"]}],
    ids=lambda change: next(iter(change)),
)
def test_a_vae_whose_config_asks_for_the_impossible_is_refused_before_memory_is_taken(change: dict, tmp_path: Path) -> None:
    from edream import catalog
    from edream.learn.codec import Codec

    path = make_files("weights", tmp_path) / "vae"
    settings = json.loads((path / "config.json").read_text())
    (path / "config.json").write_text(json.dumps(settings | change))
    with pytest.raises(EdreamError, match="is no VAE's config"):
        catalog.load("codecs", "kl_vae", Codec).build({}, path)
