"""The dream model: training that goes on exactly, checkpoints that fit or are refused, long video, streaming."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from edream.core.errors import EdreamError
from edream.learn.checkpoint import arrays, fill, read_weights, weights_digest
from edream.learn.training import AVERAGE, Schedule, new_state, part, train
from edream.vision.batches import Batches
from edream.vision.clips import clip_of, composed, images
from edream.vision.dreamer import Dreamer, DreamModel, Part, Render, finished
from edream.vision.grain import Grain
from edream.vision.judging import drawn, long_video, ready_metrics, real_clips, regions, scores, silhouette_iou
from edream.vision.variants import DREAM, REGRESSION, WITHOUT, DreamOptions, new_model, variants
from tests.dreams import small_scenes

TINY = DreamOptions(
    codec=Part("pixel_unshuffle", {"factor": 4}),
    denoiser=Part("unet", {"widths": (24, 32), "heads": 2}),
    objective=Part("bridge", {"noise": 0.1}),
    train=Schedule(steps=60, rate=4e-3, warmup=5, average=0.9),
    frames=6,
    train_frames=6,
    batch=2,
    overlap=2,
)


@pytest.fixture(autouse=True)
def one_thread() -> None:
    torch.set_num_threads(1)


def trained(scenes, options: DreamOptions, cuts: tuple[int, ...], variant: int = 0) -> tuple[DreamModel, Mapping]:
    chosen = variants(options, ("real", "sim", "crop"))[variant]
    model = new_model(options, chosen, 0)
    batches = Batches(scenes, options, chosen, 0)

    def loss(step: int) -> torch.Tensor:
        batch = batches.at(step)
        return model.loss(batch.clip, batch.known, batch.chance)

    state = new_state(model.denoiser)
    for first, last in zip((0, *cuts), (*cuts, options.train.steps), strict=True):
        state, _ = train(model.denoiser, loss, state, first, last, options.train)
    fill(model.denoiser, part(state, AVERAGE), "state")
    return model.eval(), state


def test_a_training_that_was_cut_gives_the_same_bytes(tmp_path: Path) -> None:
    scenes, options = small_scenes(tmp_path), replace(TINY, train=replace(TINY.train, steps=6))
    _, whole = trained(scenes, options, ())
    _, again = trained(scenes, options, ())
    _, pieces = trained(scenes, options, (1, 4))
    assert weights_digest(whole) == weights_digest(again) == weights_digest(pieces)
    _, other = trained(scenes, replace(options, train=replace(options.train, rate=5e-3)), ())
    assert weights_digest(other) != weights_digest(whole)


def test_training_beats_plate_and_composite_on_an_episode_it_never_saw(tmp_path: Path) -> None:
    scenes = small_scenes(tmp_path)
    model, _ = trained(scenes, TINY, ())
    picked = [(2, 0), (2, 6)]
    real, where = real_clips(scenes, picked, 6), regions(scenes, picked, 6)
    made = drawn(model, scenes, picked, 6, "real", 0, None)
    pasted = np.stack([finished(clip_of(scenes, [(n, f, "real")], 6).composite[0], None, 0) for n, f in picked])
    ours, theirs = (scores(c, real, where, ready_metrics(("psnr",), {}))["psnr"] for c in (made, pasted))
    assert ours["not object"] > theirs["not object"] + 3.0
    assert silhouette_iou(real, scenes, picked, where) > 0.8


def test_all_variants_begin_with_the_same_weights_and_differ_in_one_thing() -> None:
    chosen = variants(TINY, ("real", "crop"))
    assert [v.name for v in chosen] == [DREAM, REGRESSION, WITHOUT]
    digests = {weights_digest(arrays(new_model(TINY, v, 3).denoiser)) for v in chosen}
    assert len(digests) == 1 and chosen[0].sources == {"real": 0.34, "crop": 0.33} and chosen[2].sources == {"none": 1.0}
    assert [v.name for v in variants(replace(TINY, objects=False), ("real",))] == [DREAM, REGRESSION]


def test_long_video_has_the_same_noise_in_every_chunk_and_keeps_what_it_has(tmp_path: Path) -> None:
    scenes, model = small_scenes(tmp_path), new_model(TINY, variants(TINY, ("real",))[0], 0)
    with torch.no_grad():
        for tensor in model.denoiser.parameters():
            tensor.add_(0.02 * torch.randn(tensor.shape, generator=torch.Generator().manual_seed(1)))
    clip = clip_of(scenes, [(0, 0, "real")], 12)
    assert torch.equal(model.noise(1, 12, 32, 32, 5)[:, 4:8], model.noise(1, 4, 32, 32, 5, first=4))
    long = model.long(clip, 5, 6, 2)
    assert long.shape == clip.real.shape
    assert torch.equal(long[:, :6], model.long(replace_frames(clip, 6), 5, 6, 2)), "later chunks leave earlier ones alone"
    found = long_video(model, scenes, 2, 24, 6, 2, "real", 0)
    assert np.isfinite(found["seam_ratio"]) and np.isfinite(found["drift_db"])
    with pytest.raises(EdreamError, match="overlap"):
        model.long(clip, 5, 4, 4)


def test_images_that_are_given_stay_as_they_are(tmp_path: Path) -> None:
    scenes, model = small_scenes(tmp_path), new_model(TINY, variants(TINY, ("real",))[0], 0)
    made = drawn(model, scenes, [(2, 1)], 6, "real", 0, Grain((9.0,) * 8), None, 2)[0]
    real = scenes.layers[2]["real"][1:7]
    assert np.array_equal(made[:2], real[:2])
    assert all(np.abs(made[i].astype(float) - real[i]).mean() > 1.0 for i in range(2, 6))


def test_video_alone_goes_on_from_its_last_given_image(tmp_path: Path) -> None:
    scenes, options = small_scenes(tmp_path), replace(TINY, objects=False, onward=True)
    model = new_model(options, variants(options, ("real",))[0], 0)  # whose network gives nothing before it has learned
    made = drawn(model, scenes, [(2, 1)], 6, "none", 0, None, None, 2)[0].astype(float)
    real = scenes.layers[2]["real"][1:7].astype(float)
    assert np.abs(made[2:] - real[1]).max() <= 1.0 < np.abs(made[2:] - real[0]).mean()
    clip = clip_of(scenes, [(0, 0, "none"), (1, 0, "none")], 4)
    on = clip.onward(clip.real, torch.tensor([0, 3]))
    assert torch.equal(on.background[0], clip.background[0]) and torch.equal(on.composite[1, 3], clip.real[1, 2])
    with pytest.raises(EdreamError, match=r"dream\.onward is for video alone"):
        replace(TINY, onward=True)


def replace_frames(clip, count: int):
    return type(clip)(*(getattr(clip, name)[:, :count] for name in ("real", "composite", "background", "robot", "object")))


def test_frame_by_frame_gives_what_the_whole_clip_gives(tmp_path: Path) -> None:
    scenes, model = small_scenes(tmp_path), new_model(TINY, variants(TINY, ("real",))[0], 0)
    with torch.no_grad():
        for tensor in model.denoiser.parameters():
            tensor.add_(0.02 * torch.randn(tensor.shape, generator=torch.Generator().manual_seed(1)))
    layers, reference = scenes.layers[0], np.asarray(scenes.references[0])
    dreamer = Dreamer(model, reference, seed=4)
    state, frames = dreamer.start(), []
    for t in range(8):
        render = Render(layers["robot"][t], layers["masks"][t, ..., 0], layers["object_sim"][t], layers["object_masks"][t, ..., 0])
        state, image = dreamer.step(state, render)
        frames.append(image)
    whole = drawn(model, scenes, [(0, 0)], 8, "sim", 4, None)[0]
    assert np.abs(np.stack(frames).astype(int) - whole.astype(int)).max() <= 1


def test_a_network_that_needs_whole_clips_does_not_stream() -> None:
    model = DreamModel.of(TINY.codec, Part("svd", {"widths": (32, 32), "cross": 8, "heads": 2}), Part("edm"), 0)
    with pytest.raises(EdreamError, match="unet"):
        Dreamer(model, np.zeros((32, 32, 3), np.uint8))


def test_checkpoints_that_do_not_fit_are_refused_in_a_sentence(tmp_path: Path) -> None:
    from safetensors.numpy import save_file

    network = new_model(TINY, variants(TINY, ("real",))[0], 0).denoiser
    good = arrays(network)
    path = tmp_path / "weights.safetensors"
    save_file(good, path)
    fill(network, read_weights(path), "weights")
    name = "enter.weight"
    bad = {
        "is (24, 3": good | {name: good[name][:, :3].copy()},
        "is missing": {k: v for k, v in good.items() if k != name},
        "is unknown": good | {"more": np.zeros(3)},
        "not finite": good | {name: np.full_like(good[name], np.nan)},
    }
    for words, weights in bad.items():
        with pytest.raises(EdreamError) as caught:
            fill(network, {k: torch.from_numpy(np.array(v)) for k, v in weights.items()}, "weights")
        assert words in str(caught.value) and "\n" not in str(caught.value)
    assert weights_digest(arrays(network)) == weights_digest(good), "a refused checkpoint changes nothing"


def test_damaged_and_pickled_checkpoints_are_refused_and_nothing_in_them_runs(tmp_path: Path) -> None:
    import pickle

    class Trap:
        def __reduce__(self):
            return (Path(tmp_path / "ran").touch, ())

    pickled, torn, missing = tmp_path / "a.pt", tmp_path / "b.safetensors", tmp_path / "c.safetensors"
    pickled.write_bytes(pickle.dumps(Trap()))
    zipped = tmp_path / "d.pt"
    torch.save({"w": torch.zeros(3)}, zipped)
    torn.write_bytes(b'\x40\x00\x00\x00\x00\x00\x00\x00{"w":')
    for path, words in ((pickled, "pickled"), (zipped, "pickled"), (torn, "damaged"), (missing, "no weights")):
        with pytest.raises(EdreamError, match=words):
            read_weights(path)
    assert not (tmp_path / "ran").exists()


def test_object_over_robot_over_background() -> None:
    ones = torch.ones(1, 1, 3, 2, 2)
    half = torch.full((1, 1, 1, 2, 2), 0.5)
    assert torch.allclose(composed(0 * ones, ones, half, -ones, half), torch.full_like(ones, -0.25))
    assert torch.equal(images(np.array([[[255, 0, 0]]], np.uint8)), torch.tensor([[[1.0]], [[-1.0]], [[-1.0]]]))


def test_every_weight_of_a_model_survives_the_disk(tmp_path: Path) -> None:
    from edream import kinds

    model = DreamModel.of(Part("kl_vae", {"widths": (32, 32)}), TINY.denoiser, TINY.objective, 0)
    kinds.write(arrays(model), tmp_path / "all.safetensors")
    fill(model, read_weights(tmp_path / "all.safetensors"), "all")
