"""Files that a user gives beside recordings: a good one of each kind, and what reads it; for `python -m tests.fuzz`."""

import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

from edream.core.camera import as_json
from edream.ingest.mask_file import read_masks
from edream.sim.robot import load_robot
from edream.stages.camera import read_cameras
from edream.vision.pose import read_marks
from edream.vision.scene_file import read_scene
from tests.rendering import ROBOTS, camera_on


def _cameras(path: Path) -> None:
    moving = as_json({"side": camera_on()})["side"]
    moving["extrinsics"] = [moving["extrinsics"]] * 3
    (path / "cameras.json").write_text(json.dumps(as_json({"top": camera_on()}) | {"side": moving}))


def _marks(path: Path) -> None:
    rows = [f"one,{0.1 * i},ee,{20 + i},{30 - i},top" for i in range(8)]
    (path / "marks.csv").write_text("\n".join(["episode,time,point,u,v,camera", *rows]))


def _scene(path: Path) -> None:
    track = {"times": [0.0, 0.1], "poses": [[0.3, 0, 0.02, 1, 0, 0, 0]] * 2}
    things = [{"name": "block", "shape": "box", "size": [0.03, 0.02, 0.02], "colour": [0.8, 0.2, 0.1]}]
    (path / "scene.json").write_text(json.dumps({"objects": things, "tracks": {"one": {"block": track}}}))


def _masks(path: Path) -> None:
    masks = np.zeros((3, 9, 9), np.uint8)
    masks[:, 2:5, 3:8] = 255
    np.savez_compressed(path / "packed.npz", masks)
    np.savez(path / "plain.npz", masks)
    rows = [{"size": [9, 9], "counts": "m03600000007"}, None, {"size": [9, 9], "counts": [29, 3, 6, 3, 6, 3, 6, 3, 6, 3, 13]}]
    (path / "lengths.json").write_text(json.dumps(rows))
    (path / "pictures").mkdir()
    for i, mask in enumerate(masks):
        cv2.imwrite(str(path / "pictures" / f"{i}.png"), mask)


def _weights(path: Path) -> None:
    from diffusers.models.autoencoders.autoencoder_kl import AutoencoderKL

    AutoencoderKL(block_out_channels=(32,), layers_per_block=1).save_pretrained(path / "vae")


def _robot(path: Path) -> None:
    (path / "robot.xml").write_text((ROBOTS / "pan_tilt.xml").read_text())


def _read_scene(path: Path) -> None:
    read_scene(path / "scene.json").at("one", 0.05)


def _read_weights(path: Path) -> None:
    from edream import catalog
    from edream.learn.codec import Codec

    catalog.load("codecs", "kl_vae", Codec).build({}, path / "vae")


FILES: dict[str, tuple[Callable[[Path], None], tuple[Callable[[Path], object], ...]]] = {
    "cameras": (_cameras, (lambda path: read_cameras(path / "cameras.json"),)),
    "marks": (_marks, (lambda path: read_marks(path / "marks.csv"),)),
    "masks": (_masks, tuple(lambda path, one=one: read_masks(path, one) for one in ("packed", "plain", "lengths", "pictures"))),
    "robot": (_robot, (lambda path: load_robot(path / "robot.xml", "robot", "ee"),)),
    "scene": (_scene, (_read_scene,)),
    "weights": (_weights, (_read_weights,)),
}


def make_files(name: str, folder: Path) -> Path:
    """A folder with a good file of this kind."""
    path = folder / f"files_{name}"
    path.mkdir()
    FILES[name][0](path)
    return path


def read_files(name: str, path: Path) -> list[str]:
    """Read what is there; what was said against it."""
    from edream.core.errors import EdreamError

    said = []
    for read in FILES[name][1]:
        try:
            read(path)
        except EdreamError as error:
            said.append(str(error))
    return said
