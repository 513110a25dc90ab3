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


def known_of(recorded: Path) -> list[str]:
    """What lies beside the recordings, as settings."""
    beside = {"camera.file": "cameras.json", "render.scene": "scene.json", "masks.truth": "truth.masks.npz"}
    return [f"{name}={recorded}.{end}" for name, end in beside.items()]


def settings(recorded: Path, runs: Path, *more: str) -> DictConfig:
    beside = known_of(recorded)
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
    parts = {"object", "robot", "not object"}
    for row in (row for row in rows if row["label"] != "real"):
        assert all(parts <= set(found) for name, found in row.items() if name not in ("label", "silhouette_iou")), row
    page = artifacts["report"]["report.html"]
    assert "By part of the image" in page and page.count("data:image/png;base64,") >= 6 and 'src="http' not in page


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
    words = known_of(recorded)
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
    again, once = pipeline.make("score", cfg), made[1]["score"]
    assert again.digest == once.digest, "the same frames and numbers"
    assert again["strip-0.png"] == once["strip-0.png"] and again["scores.json"] == once["scores.json"]


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


def test_calibrate_camera_tells_the_reprojection_error_of_marked_points(made, recorded: Path, tmp_path: Path) -> None:
    import mujoco
    from typer.testing import CliRunner

    from edream.cli import app
    from edream.core.camera import from_json
    from edream.ingest.stored import stored_episodes

    true = from_json(json.loads(Path(f"{recorded}.cameras.json").read_text()), "truth")["cam_high"]
    model, lines, rng = pan_tilt().model, ["episode,time,point,u,v"], np.random.default_rng(0)
    data = mujoco.MjData(model)
    for episode in stored_episodes(pipeline.make("ingest", made[0])):
        for row in (2, 8, 14):
            data.qpos[:] = episode.position[row]
            mujoco.mj_kinematics(model, data)
            for point, place in (("ee", data.site("ee").xpos), ("head", data.body("head").xpos)):
                u, v = true.project(place[None])[0] + rng.normal(0, 0.1, 2)
                lines.append(f"{episode.name},{episode.times[row] - episode.times[0]:.4f},{point},{u:.3f},{v:.3f}")
    marks = tmp_path / "marks.csv"
    marks.write_text("\n".join(lines))
    words = ["robot=pan_tilt", f"data={recorded}", f"runs={made[0].runs}", f"camera.marks={marks}", "camera.source=marks"]
    done = CliRunner().invoke(app, ["calibrate", "--json", "camera", *words])
    assert done.exit_code == 0, done.output
    told = json.loads(done.output)
    assert told["reprojection_error_px"] < 0.3 and "reprojection error" in told["sentence"]
    found = from_json(json.loads((Path(told["artifact"]) / "cameras.json").read_text()), "found")["cam_high"]
    assert np.linalg.norm(found.pose[:3, 3] - true.pose[:3, 3]) < 0.05


def test_a_checkpoint_from_elsewhere_is_one_sentence_and_exit_code_2(
    made, recorded: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    import torch
    from diffusers.models.autoencoders.autoencoder_kl import AutoencoderKL

    from edream.cli import main

    folder = tmp_path / "vae"
    AutoencoderKL(block_out_channels=(32,), layers_per_block=1).save_pretrained(folder)
    weights = folder / "diffusion_pytorch_model.safetensors"
    good = weights.read_bytes()
    torch.save({"w": torch.zeros(3)}, tmp_path / "pickled")
    bad = {"pickled": (tmp_path / "pickled").read_bytes(), "damaged": good[: len(good) // 2]}
    beside = known_of(recorded)
    words = ["robot=pan_tilt", f"data={recorded}", f"runs={made[0].runs}", "seed=1", *beside, *SMALL]
    words += ["dream.codec.kind=kl_vae", f"dream.codec.weights={folder}"]

    def refused(said: str) -> None:
        monkeypatch.setattr(sys, "argv", ["edream", "dream", *words])
        with pytest.raises(SystemExit) as left:
            main()
        last = capsys.readouterr().err.strip().splitlines()[-1]
        assert left.value.code == 2 and said in last and last.endswith("."), last

    for said, data in bad.items():
        weights.write_bytes(data)
        refused(said)
    weights.write_bytes(good)
    config_file = folder / "config.json"
    config_file.write_text(config_file.read_text().replace("32", "64"))
    refused("does not fit this network")


def test_a_camera_found_with_a_poor_overlap_is_doubted_aloud(made, recorded: Path) -> None:
    wrong = ["camera.source=silhouettes", "camera.guess.azimuth=180", "camera.frames=4", "camera.evaluations=20"]
    told = pipeline.make("camera", settings(recorded, Path(made[0].runs), *wrong))["summary.json"]
    assert told["silhouette_iou"] < 0.5 and "do not trust this pose: give camera.marks" in told["sentence"]
    known = pipeline.make("camera", settings(recorded, Path(made[0].runs)))["summary.json"]
    assert "trust" not in known["sentence"]


def test_recordings_shorter_than_a_clip_are_said_before_anything_is_trained(made, recorded: Path) -> None:
    cfg = settings(recorded, Path(made[0].runs), "dream.frames=40")
    with pytest.raises(EdreamError, match=r"has 40 images \(the longest has 16\); lower dream\.frames"):
        pipeline.make("dream", cfg)
    assert not list(Path(made[0].runs).glob("dream/.work-*/dream-0000000"))


def test_video_without_a_robot_model_becomes_conditions_too(recorded: Path, tmp_path: Path) -> None:
    cfg = settings(
        recorded, tmp_path / "runs", "render.model=none", "render.scene=null", "ingest.mapping.by=none", "masks.truth=null"
    )
    made = pipeline.make("condition", cfg)
    assert made["summary.json"]["object_sources"] == ["real", "crop"] and made["summary.json"]["frames"] == 5 * 16


ALONE = [word for word in SMALL if not word.startswith(("render.model", "score.long", "score.steps"))]


@pytest.mark.parametrize("objective", [pytest.param("bridge", marks=pytest.mark.slow), "epsilon"])
def test_video_alone_goes_through_a_vae_trained_here_beside_what_the_codec_alone_gives_back(
    objective: str, recorded: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    words = ["dream.codec.kind=kl_vae", "dream.codec.options={widths: [32, 32]}", "dream.codec_steps=2", "score.steps=[3]"]
    runs = tmp_path_factory.getbasetemp() / "alone"
    mine = ["experiment=video", f"data={recorded}", f"runs={runs}", "seed=1", "report.of=dream", *ALONE, *words]
    made, _ = pipeline.make_run("dream", ("score", "report"), config.compose([*mine, f"dream.objective.kind={objective}"]))
    rows = {row["label"]: row for row in made["score"]["scores.json"]["rows"]}
    after = " after 2 real images"
    assert {f"codec alone{after}", f"held still{after}", f"dream none{after}", f"dream none in 3 steps{after}"} <= set(rows)
    assert made["score"]["summary.json"]["codec_psnr"] == made["codec"]["summary.json"]["psnr"]
    assert "The codec alone reaches" in made["report"]["report.html"] and f"codec alone{after}" in made["report"]["report.html"]
    if objective == "epsilon":
        assert len(list(runs.glob("codec/*/manifest.json"))) == 1, "both objectives learn on the same latents"


SEGMENTERS = {
    "track": ["masks.options={boxes: {all: [0.3, 0.3, 0.4, 0.4]}}"],
    "precomputed": ["masks.folder=FOLDER"],
    "sim": [],
    "sam2": ["masks.weights=FOLDER", "masks.options={boxes: {all: [0.3, 0.3, 0.4, 0.4]}}"],
    "none": [],
}


@pytest.mark.parametrize("name", SEGMENTERS)
def test_every_segmenter_is_named_by_a_setting(name: str, made, recorded: Path, tmp_path: Path) -> None:
    if name == "sam2":
        pytest.importorskip("transformers", reason="the extra sam2 is not installed")
        from tests.tiny_sam2 import save_sam2

        save_sam2(tmp_path / "sam2")
    if name == "precomputed":
        for number in range(5):
            np.savez(tmp_path / f"episode_{number}.npz", np.ones((16, 32, 32), np.uint8))
    words = [word.replace("FOLDER", str(tmp_path)) for word in SEGMENTERS[name]]
    masks = pipeline.make("masks", settings(recorded, Path(made[0].runs), f"masks.segmenter={name}", *words))
    told = masks["summary.json"]
    assert told["segmenter"] == name and masks["overlay.png"].startswith(b"\x89PNG")
    assert (told["object_share"] == 0.0) == (name == "none")
    assert name != "sim" or told["iou_mean"] > 0.8
    with pytest.raises(EdreamError, match=f"option of segmenter '{name}': 'diference'"):
        pipeline.make("masks", settings(recorded, Path(made[0].runs), f"masks.segmenter={name}", "masks.options.diference=3"))


@pytest.fixture(scope="module")
def two_cameras(recorded: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The recordings with a second camera, which is the first one's image upside down, and a file that says where both stand."""
    import shutil

    import h5py

    folder = tmp_path_factory.mktemp("two") / "rec"
    shutil.copytree(recorded, folder)
    for path in folder.glob("*.hdf5"):
        with h5py.File(path, "r+") as opened:
            images = opened["observations/images"]
            images.create_dataset("cam_low", data=images["cam_high"][:][:, ::-1, ::-1])
    cameras = json.loads(Path(f"{recorded}.cameras.json").read_text())
    one = cameras["cam_high"]
    pose, matrix = np.array(one["extrinsics"]), np.array(one["intrinsics"])
    pose[:3, :2] *= -1.0  # turned by half a turn about its axis
    matrix[0, 2], matrix[1, 2] = one["width"] - matrix[0, 2], one["height"] - matrix[1, 2]
    cameras["cam_low"] = one | {"extrinsics": pose.tolist(), "intrinsics": matrix.tolist()}
    Path(f"{folder}.cameras.json").write_text(json.dumps(cameras))
    return folder


def test_each_camera_has_its_own_view_plate_and_masks_and_no_recording_is_on_both_sides(
    two_cameras: Path, recorded: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from edream.ingest.layered import images_of, layered_episodes
    from edream.stages import render

    words = [
        f"camera.file={two_cameras}.cameras.json",
        f"render.scene={recorded}.scene.json",
        "camera.name=all",
        "executor.workers=2",
    ]
    base = [f"data={two_cameras}", "robot=pan_tilt", "seed=1", *words, *SMALL]
    cfg = config.compose([*base, f"runs={tmp_path / 'runs'}"])
    rendered, condition = pipeline.make("render", cfg), pipeline.make("condition", cfg)
    views = {one.name: images_of(one, ("real", "robot", "masks")) for one in layered_episodes(condition)}
    assert len(views) == 10 and {"episode_0.cam_high", "episode_0.cam_low"} <= set(views)
    assert rendered["summary.json"]["views"]["episode_0.cam_low"] == ["episode_0", "cam_low"]
    high, low = views["episode_0.cam_high"], views["episode_0.cam_low"]
    assert np.array_equal(high["real"], low["real"][:, ::-1, ::-1])
    assert np.abs(high["robot"].astype(int) - low["robot"][:, ::-1, ::-1]).mean() < 1.0, "each is rendered from its own pose"
    one, other = high["masks"][..., 1] > 127, low["masks"][:, ::-1, ::-1, 1] > 127
    assert (one & other).sum() / (one | other).sum() > 0.8
    held = condition["summary.json"]["held"]
    assert held and {name.partition(".")[0] for name in held} & {n.partition(".")[0] for n in set(views) - set(held)} == set()
    monkeypatch.setattr(render, "MANY", 0)
    again = pipeline.make("render", config.compose([*base, f"runs={tmp_path / 'other'}"]))
    assert again.digest == rendered.digest, "several processes render the same bytes as one"


@pytest.fixture(scope="module")
def svd_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A tiny Stable Video Diffusion with random weights, as diffusers writes it: `vae` with the temporal decoder, and `unet`."""
    import torch
    from diffusers.models.autoencoders.autoencoder_kl_temporal_decoder import AutoencoderKLTemporalDecoder
    from diffusers.models.unets.unet_spatio_temporal_condition import UNetSpatioTemporalConditionModel

    folder = tmp_path_factory.mktemp("svd")
    torch.manual_seed(0)
    AutoencoderKLTemporalDecoder(
        down_block_types=("DownEncoderBlock2D",) * 2, block_out_channels=(32, 32), layers_per_block=1
    ).save_pretrained(folder / "vae")
    UNetSpatioTemporalConditionModel(
        in_channels=8,
        down_block_types=("CrossAttnDownBlockSpatioTemporal", "DownBlockSpatioTemporal"),
        up_block_types=("UpBlockSpatioTemporal", "CrossAttnUpBlockSpatioTemporal"),
        block_out_channels=(32, 32),
        addition_time_embed_dim=16,
        projection_class_embeddings_input_dim=48,
        layers_per_block=1,
        cross_attention_dim=8,
        num_attention_heads=(2, 2),
    ).save_pretrained(folder / "unet")
    return folder


PRETRAINED = ["dream=svd", "dream.device=cpu", "dream.train.steps=2", "dream.checkpoint=1", "dream.batch=1", "dream.train_frames=4"]
PRETRAINED += ["dream.frames=6", "dream.overlap=2", "score.clips=2", "score.long=0", "score.steps=[]", "score.metrics=[psnr]"]


def test_stable_video_diffusions_own_weights_are_trained_on_and_scored_from_a_local_folder(
    made, recorded: Path, svd_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from edream.objectives.edm import Edm

    monkeypatch.setattr(Edm, "steps", 3)  # of sampling: with random weights more of them show nothing more
    words = [f"dream.codec.weights={svd_folder}/vae", f"dream.denoiser.weights={svd_folder}/unet"]
    runs = str(made[0].runs)
    base = [word for word in SMALL if not word.startswith(("dream", "score"))]
    beside = known_of(recorded)
    cfg = config.compose(["robot=pan_tilt", f"data={recorded}", f"runs={runs}", "seed=1", *beside, *base, *PRETRAINED, *words])
    codec, score = pipeline.make("codec", cfg), pipeline.make("score", cfg)
    latents = codec["latents/000000.safetensors"]
    assert latents["real"].shape == (16, 4, 16, 16) and latents["reference"].shape == (1, 4, 16, 16)
    assert score["summary.json"]["codec_psnr"] == codec["summary.json"]["psnr"] and np.isfinite(score["summary.json"]["psnr"])
    other = pipeline.make("dream", config.compose([*_words(cfg), *beside, *base, *PRETRAINED, *words, "dream.train.rate=0.001"]))
    assert other.manifest["parents"]["codec"] == codec.key, "other training settings find the same latents"


def _words(cfg: DictConfig) -> list[str]:
    return ["robot=pan_tilt", f"data={cfg.data}", f"runs={cfg.runs}", "seed=1"]


@pytest.mark.slow
def test_two_processes_of_torchrun_go_from_conditions_to_a_page(made, recorded: Path) -> None:
    words = known_of(recorded)
    command = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node=2", "--no-python", sys.executable]
    command += ["-c", "from edream.cli import main; main()", "dream", "--json", "robot=pan_tilt", f"data={recorded}"]
    command += [
        f"runs={made[0].runs}",
        "seed=1",
        *words,
        *SMALL,
        "dream.baseline=false",
        "dream.ablation=false",
        "score.metrics=[psnr]",
    ]
    done = subprocess.run(command, capture_output=True, text=True, timeout=280, env=os.environ | {"OMP_NUM_THREADS": "1"})
    assert done.returncode == 0, done.stderr[-2000:]
    told = json.loads(done.stdout)
    assert Path(told["report"]).is_file() and told["weights_digest"] != made[1]["dream"]["summary.json"]["weights_digest"]
