"""From recordings with video to a report of dreamed video, end to end, on a small robot with a smaller model."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from omegaconf import DictConfig

from edream import config, pipeline
from edream.core.errors import EdreamError
from edream.reality.look import Look
from edream.record import RecordConfig, record
from tests.rendering import pan_tilt

SMALL = [
    "render.height=32",
    "render.width=32",
    "render.rate=null",
    "render.model=published",
    "dream.denoiser.options={widths: [16, 24], heads: 2}",
    "dream.frames=6",
    "dream.train_frames=4",
    "dream.overlap=2",
    "dream.batch=2",
    "dream.train.steps=8",
    "dream.checkpoint=4",
    "score.clips=6",
    "score.long=14",
    "score.steps=[2]",
]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory, rendering: None) -> Path:
    """Five short recordings with video, and what lies beside them."""
    out = tmp_path_factory.mktemp("dream") / "rec"
    options = RecordConfig(out, motions=5, seconds=1.6, rate=10.0, video=True, look=Look(48, 48))
    record(pan_tilt(), options, seed=2)
    return out


def settings(recorded: Path, runs: Path, *more: str) -> DictConfig:
    beside = [
        f"camera.file={recorded}.cameras.json",
        f"render.scene={recorded}.scene.json",
        f"masks.truth={recorded}.truth.masks.npz",
    ]
    return config.compose(
        ["robot=pan_tilt", f"data={recorded}", f"runs={runs}", "seed=1", "report.of=dream", *beside, *SMALL, *more]
    )


@pytest.fixture(scope="module")
def made(recorded: Path, tmp_path_factory: pytest.TempPathFactory):
    cfg = settings(recorded, tmp_path_factory.mktemp("runs"))
    return cfg, pipeline.make_run("dream", ("score", "report"), cfg)[0]


def test_dream_goes_from_recordings_to_a_page_with_strips(made) -> None:
    artifacts = made[1]
    summary, rows = artifacts["score"]["summary.json"], artifacts["score"]["scores.json"]["rows"]
    labels = {row["label"] for row in rows}
    assert {"plate", "composite real", "dream real", "dream sim", "dream crop", "regression real", "no objects", "real"} <= labels
    assert np.isfinite(summary["psnr"]) and 0.0 <= summary["silhouette_iou"] <= 1.0
    assert artifacts["masks"]["summary.json"]["iou_mean"] > 0.5
    page = artifacts["report"]["report.html"]
    assert page.count("data:image/png;base64,") >= 6 and 'src="http' not in page


def test_a_second_run_makes_nothing_anew(made) -> None:
    cfg, artifacts = made
    again = pipeline.make_run("dream", ("score", "report"), cfg)[0]
    assert {name: one.key for name, one in again.items()} == {name: one.key for name, one in artifacts.items()}
    assert all(one.manifest["made"] == artifacts[name].manifest["made"] for name, one in again.items())


def test_conditions_are_episodes_that_foxglove_opens_with_the_object_before_black(made) -> None:
    from edream.ingest.layered import images_of, layered_episodes

    episode = next(layered_episodes(made[1]["condition"]))
    layers = images_of(episode, ("real", "condition", "masks", "reference"))
    thing = layers["masks"][..., 1] > 127
    free = ~thing & (layers["masks"][..., 0] == 0)
    assert np.array_equal(layers["condition"][thing], layers["real"][thing]) and not layers["condition"][free].any()
    assert len(layers["reference"]) == 1 and thing.any()


def test_a_training_that_is_killed_goes_on_and_gives_the_same_weights(made, recorded: Path, tmp_path: Path) -> None:
    runs = tmp_path / "runs"
    words = [
        f"camera.file={recorded}.cameras.json",
        f"render.scene={recorded}.scene.json",
        f"masks.truth={recorded}.truth.masks.npz",
    ]
    command = [sys.executable, "-c", "from edream.cli import main; main()", "dream", "--json", "robot=pan_tilt", f"data={recorded}"]
    command += [f"runs={runs}", "seed=1", *words, *SMALL]
    killed = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, start_new_session=True, env=os.environ)
    until = time.monotonic() + 100
    while (
        not list((runs / "dream").glob(".work-*/dream-0000000/000000/manifest.json"))
        and killed.poll() is None
        and time.monotonic() < until
    ):
        time.sleep(0.02)
    os.killpg(killed.pid, signal.SIGKILL)
    killed.wait()
    assert not list((runs / "dream").glob("*/manifest.json")), "it was killed in the middle of its training"
    cfg = settings(recorded, runs)
    assert pipeline.make("dream", cfg)["summary.json"] == made[1]["dream"]["summary.json"]


def test_a_camera_that_sees_no_robot_is_a_sentence(recorded: Path, tmp_path: Path) -> None:
    cameras = json.loads(Path(f"{recorded}.cameras.json").read_text())
    pose = np.array(cameras["cam_high"]["extrinsics"])
    pose[:3, 3] += 100.0 * pose[:3, 0]
    cameras["cam_high"]["extrinsics"] = pose.tolist()
    wrong = tmp_path / "cameras.json"
    wrong.write_text(json.dumps(cameras))
    with pytest.raises(EdreamError, match="not to be seen from camera"):
        pipeline.make("render", settings(recorded, tmp_path / "runs", f"camera.file={wrong}"))


def test_recordings_without_video_are_a_sentence(tmp_path: Path) -> None:
    out = tmp_path / "rec"
    record(pan_tilt(), RecordConfig(out, motions=2, seconds=1.0, rate=10.0), seed=2)
    cfg = config.compose(["robot=pan_tilt", f"data={out}", f"runs={tmp_path / 'runs'}"])
    with pytest.raises(EdreamError, match="no video"):
        pipeline.make("camera", cfg)


def test_video_without_a_robot_model_becomes_conditions_too(recorded: Path, tmp_path: Path) -> None:
    cfg = settings(
        recorded, tmp_path / "runs", "render.model=none", "render.scene=null", "ingest.mapping.by=none", "masks.truth=null"
    )
    made = pipeline.make("condition", cfg)
    assert made["summary.json"]["object_sources"] == ["real", "crop"] and made["summary.json"]["frames"] == 5 * 16
