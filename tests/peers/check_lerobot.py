"""Load LeRobot data sets in the real client; run in an environment of its own, which holds no edream.

python -m venv build/lerobot
build/lerobot/bin/pip install torch==2.13.0 lerobot-dataset==0.4.4
build/lerobot/bin/pip install --no-deps torchvision==0.25.0
build/lerobot/bin/python tests/peers/check_lerobot.py FOLDER...
"""

import json
import os
import sys
from pathlib import Path

os.environ["HF_HUB_OFFLINE"] = "1"

import torch

# torchvision's own operators were built for another torch; importing it only needs this one declared
_LIBRARY = torch.library.Library("torchvision", "DEF")
_LIBRARY.define("nms(Tensor dets, Tensor scores, float iou_threshold) -> Tensor")

from ledataset.datasets.lerobot_dataset import LeRobotDataset  # noqa: E402


def check(folder: Path) -> None:
    info = json.loads((folder / "meta/info.json").read_text())
    dataset = LeRobotDataset(f"local/{folder.name}", root=folder, tolerance_s=0.01)
    assert len(dataset) == info["total_frames"], f"{folder}: {len(dataset)} frames, info.json says {info['total_frames']}"
    assert dataset.num_episodes == info["total_episodes"]
    for row in sorted({0, len(dataset) // 2, len(dataset) - 1}):
        frame = dataset[row]
        for key, feature in info["features"].items():
            value = frame[key]
            if feature["dtype"] in ("image", "video"):
                height, width, _ = feature["shape"]
                assert tuple(value.shape) == (3, height, width), f"{folder}: {key} has shape {tuple(value.shape)}"
                assert float(value.min()) >= 0.0 and float(value.max()) <= 1.0
            else:
                assert torch.isfinite(value.double()).all(), f"{folder}: {key} is not finite in row {row}"
        assert isinstance(frame["task"], str) and frame["task"]
    print(f"{folder}: {dataset.num_episodes} episodes, {len(dataset)} frames load in the client")


if __name__ == "__main__":
    if len(sys.argv) < 2:
        sys.exit("give at least one LeRobot data set")
    for name in sys.argv[1:]:
        check(Path(name))
