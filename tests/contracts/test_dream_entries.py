"""Every codec, denoiser, objective, metric and segmenter keeps its contract."""

from pathlib import Path

import numpy as np
import pytest
import torch

from edream import catalog
from edream.core.errors import EdreamError
from edream.core.metric import Metric
from edream.core.segmenter import Footage, Segmenter
from edream.learn.codec import Codec
from edream.learn.denoiser import Denoiser, Shown
from edream.learn.objective import Objective

SMALL = {"unet": {"widths": (16, 32), "heads": 2}, "svd": {"widths": (32, 32), "cross": 8, "heads": 2}}
CODECS = {"pixel_unshuffle": {"factor": 2}, "kl_vae": {"widths": (32, 32)}}
chance = np.random.default_rng(0)


@pytest.fixture(autouse=True)
def one_thread() -> None:
    torch.set_num_threads(1)


@pytest.mark.parametrize("name", catalog.names("codecs"))
def test_a_codec_says_its_shape_and_whether_it_loses_anything(name: str) -> None:
    torch.manual_seed(0)
    codec = catalog.load("codecs", name, Codec).build(CODECS[name], None).eval()
    images = torch.rand(2, 3, 16, 32) * 2 - 1
    with torch.no_grad():
        latents = codec.encode(images)
        back = codec.decode(latents)
    assert latents.shape == (2, codec.channels, 16 // codec.factor, 32 // codec.factor) and back.shape == images.shape
    assert not codec.lossless or torch.equal(back, images)


def test_a_codec_with_svds_temporal_decoder_is_loaded_by_its_config_and_looks_at_neighbours(tmp_path: Path) -> None:
    from diffusers.models.autoencoders.autoencoder_kl_temporal_decoder import AutoencoderKLTemporalDecoder

    torch.manual_seed(0)
    blocks = {"down_block_types": ("DownEncoderBlock2D",) * 2, "block_out_channels": (32, 32), "layers_per_block": 1}
    network = AutoencoderKLTemporalDecoder(**blocks, scaling_factor=0.5)
    with torch.no_grad():
        network.decoder.time_conv_out.weight.add_(0.05 * torch.randn_like(network.decoder.time_conv_out.weight))
    network.save_pretrained(tmp_path / "vae")
    codec = catalog.load("codecs", "kl_vae", Codec).build({}, tmp_path / "vae").eval()
    images = torch.rand(5, 3, 16, 16) * 2 - 1
    with torch.no_grad():
        latents = codec.encode(images)
        assert torch.allclose(latents, network.encode(images).latent_dist.mean * 0.5, atol=1e-6)
        assert torch.allclose(codec.decode(latents), network.decode(latents / 0.5, num_frames=5).sample, atol=1e-6)
        assert not torch.allclose(codec.decode(latents)[:1], codec.decode(latents[:1]), atol=1e-4)
    (tmp_path / "vae" / "config.json").write_text("{}")
    with pytest.raises(EdreamError, match="no VAE's config"):
        catalog.load("codecs", "kl_vae", Codec).build({}, tmp_path / "vae")


def test_a_learned_codec_gets_better_when_it_is_trained() -> None:
    torch.manual_seed(0)
    entry = catalog.load("codecs", "kl_vae", Codec)
    codec = entry.build(CODECS["kl_vae"], None)
    losses = entry.train(codec, torch.rand(24, 3, 1, 1).expand(24, 3, 8, 8) * 2 - 1, 30, seed=0)
    assert np.mean(losses[-5:]) < 0.85 * np.mean(losses[:5])


def test_a_trained_codecs_latents_are_of_unit_size_in_every_channel_and_lead_back() -> None:
    torch.manual_seed(0)
    entry = catalog.load("codecs", "kl_vae", Codec)
    codec = entry.build(CODECS["kl_vae"], None)
    pictures = torch.rand(24, 3, 4, 4).repeat_interleave(4, 2).repeat_interleave(4, 3) * 2 - 1
    entry.train(codec, pictures, 30, seed=0)
    with torch.no_grad():
        latents = codec.encode(pictures)
        plain = codec.network.decode(codec.network.encode(pictures).latent_dist.mean).sample
        assert torch.allclose(latents.mean(dim=(0, 2, 3)), torch.zeros(codec.channels), atol=1e-3)
        assert torch.allclose(latents.std(dim=(0, 2, 3)), torch.ones(codec.channels), atol=1e-3)
        assert torch.allclose(codec.decode(latents), plain, atol=1e-4)


@pytest.mark.parametrize("name", catalog.names("denoisers"))
def test_a_new_denoiser_passes_the_composite_on_and_refuses_options_it_does_not_know(name: str) -> None:
    torch.manual_seed(0)
    entry = catalog.load("denoisers", name, Denoiser)
    network = entry.build(12, 32, SMALL[name], None).eval()
    x, shown = torch.randn(1, 4, 12, 8, 8), Shown(torch.randn(1, 4, 24, 8, 8), torch.randn(1, 4, 8, 8, 8))
    with torch.no_grad():
        out = network(x, torch.full((1, 4), 0.5), shown)
    assert out.shape == x.shape and not out.any()
    with pytest.raises(EdreamError, match="widhts"):
        entry.build(12, 32, {"widhts": (8,)}, None)


def test_the_unet_sees_nothing_of_the_future_and_streams_what_it_makes_at_once() -> None:
    torch.manual_seed(1)
    network = catalog.load("denoisers", "unet", Denoiser).build(12, 32, SMALL["unet"], None).eval()
    with torch.no_grad():
        for tensor in network.parameters():
            tensor.add_(0.05 * torch.randn_like(tensor))
    x, t = torch.randn(1, 20, 12, 8, 8), torch.full((1, 20), 0.7)
    shown = Shown(torch.randn(1, 20, 24, 8, 8), torch.randn(1, 20, 8, 8, 8))
    changed = x.clone()
    changed[:, 12:] += 1.0
    with torch.no_grad():
        whole, other = network(x, t, shown), network(changed, t, shown)
        state: dict[str, torch.Tensor] = {}
        sizes, parts = set(), []
        for i in range(20):
            now = Shown(shown.latents[:, i : i + 1], shown.masks[:, i : i + 1])
            parts.append(network(x[:, i : i + 1], t[:, i : i + 1], now, state))
            if i >= 16:
                sizes.add(sum(tensor.numel() for tensor in state.values()))
    assert torch.allclose(whole[:, :12], other[:, :12], atol=1e-5) and not torch.allclose(whole[:, 12:], other[:, 12:], atol=1e-3)
    assert torch.allclose(torch.cat(parts, dim=1), whole, atol=1e-4)
    assert len(sizes) == 1, "the state of a stream stays of one size"


@pytest.mark.parametrize("name", catalog.names("objectives"))
def test_a_perfect_network_draws_the_real_clip(name: str) -> None:
    """The network is the best there is for its objective: it knows the real clip."""
    objective = catalog.load("objectives", name, Objective)
    real, composite = torch.randn(1, 5, 3, 4, 4) * 0.4, torch.randn(1, 5, 3, 4, 4) * 0.4
    noise = torch.randn(1, 5, 3, 4, 4)
    made = objective.sample(_oracle(name, real, composite), composite, noise, max(objective.steps, 40), {})
    assert torch.allclose(made, real, atol=0.02)
    known = objective.sample(_oracle(name, real, composite), composite, noise, 10, {}, real[:, :2])
    assert torch.equal(known[:, :2], real[:, :2])


def _oracle(name: str, real: torch.Tensor, composite: torch.Tensor):
    def network(x: torch.Tensor, t: torch.Tensor) -> torch.Tensor:
        level = t[:, :, None, None, None]
        if name == "epsilon":
            return (x - torch.cos(level * torch.pi / 2) * real) / torch.sin(level * torch.pi / 2)
        if name == "edm":
            s = torch.exp(4.0 * level)
            total = (s**2 + 0.25).sqrt()
            return ((x * total) * 0.25 / total**2 - real) * total / (s * 0.5)
        return real - composite

    return network


@pytest.mark.parametrize("name", catalog.names("objectives"))
def test_a_loss_does_not_count_known_frames_and_repeats_with_its_chance(name: str) -> None:
    objective = catalog.load("objectives", name, Objective)
    real, composite = torch.randn(2, 4, 3, 4, 4), torch.randn(2, 4, 3, 4, 4)
    known = torch.zeros(2, 4, dtype=torch.bool)
    known[:, 0] = True
    weight = torch.tensor(0.1, requires_grad=True)

    def loss(target: torch.Tensor) -> torch.Tensor:
        return objective.loss(lambda x, t: weight * x, target, composite, known, torch.Generator().manual_seed(3), {})

    assert torch.equal(loss(real), loss(real))
    loss(real).backward()
    assert weight.grad is not None and torch.isfinite(weight.grad)


@pytest.mark.parametrize("name", [n for n in catalog.names("metrics") if not catalog.load("metrics", n, Metric).learned])
def test_a_metric_prefers_the_real_clip_and_less_noise(name: str) -> None:
    metric = catalog.load("metrics", name, Metric)
    rng = np.random.default_rng(2)
    real = np.clip(rng.integers(60, 200, (6, 1, 24, 24, 3)) + rng.normal(0, 6, (6, 6, 24, 24, 3)), 0, 255).astype(np.uint8)
    region = np.ones(real.shape[:4], bool)

    def worse(noise: float) -> float:
        made = np.clip(real + np.random.default_rng(3).normal(0, noise, real.shape), 0, 255).astype(np.uint8)
        value = metric.score(made, real, region)
        assert value is not None and np.isfinite(value)
        return {"more": -value, "less": value, "one": abs(np.log(max(value, 1e-9)))}[metric.better]

    assert worse(0.0) < worse(10.0) < worse(40.0)
    if metric.regional:
        assert metric.score(real, real, np.zeros_like(region)) is None
        made, left = real // 2, region & (np.arange(24) < 12)
        each = metric.each(made, real, {"left": left, "nowhere": np.zeros_like(region), "all": region})
        assert each == {"left": metric.score(made, real, left), "nowhere": None, "all": metric.score(made, real, region)}


def footage() -> tuple[Footage, np.ndarray]:
    """A textured scene with a robot, its shadow, and a bright object; and where the object truly is."""
    rng = np.random.default_rng(5)
    plate = rng.integers(100, 140, (48, 48, 3)).astype(np.uint8)
    real, robot, truth = np.repeat(plate[None], 8, axis=0), np.zeros((8, 48, 48), np.uint8), np.zeros((8, 48, 48), np.uint8)
    for t in range(8):
        real[t, 5:20, 4 + t : 14 + t], robot[t, 5:20, 4 + t : 14 + t] = (30, 30, 35), 255
        real[t, 22:30, 4 + t : 14 + t] = plate[22:30, 4 + t : 14 + t] * 0.6
        real[t, 30:40, 20 + t : 32 + t], truth[t, 30:40, 20 + t : 32 + t] = (200, 60, 30), 1
    real = np.clip(real + rng.normal(0, 2, real.shape), 0, 255).astype(np.uint8)
    return Footage("one", real, plate, robot, truth * np.uint8(255)), truth


@pytest.mark.parametrize("name", ["plate", "track", "precomputed", "sim"])
def test_a_segmenter_finds_the_object_and_leaves_robot_and_shadow_out(name: str, tmp_path: Path) -> None:
    seen, truth = footage()
    np.savez(tmp_path / "one.npz", truth)
    options = {"track": {"boxes": {"all": [20 / 48, 30 / 48, 12 / 48, 10 / 48]}}, "precomputed": {"folder": tmp_path}}.get(name, {})
    found = catalog.load("segmenters", name, Segmenter).masks(seen, options)
    assert (found & truth).sum() / (found | truth).sum() > 0.8
    assert not (found & (seen.robot > 127)).any()


def test_a_thing_that_the_robot_holds_is_found_up_to_the_fingers() -> None:
    seen, truth = footage()
    thing = np.array([200, 60, 30], np.uint8)
    for t in range(8):
        seen.real[t, 20:30, 8 + t : 10 + t], seen.robot[t, 20:30, 8 + t : 10 + t] = (30, 30, 35), 255
        seen.real[t, 20:30, 16 + t : 18 + t], seen.robot[t, 20:30, 16 + t : 18 + t] = (30, 30, 35), 255
        seen.real[t, 22:34, 10 + t : 16 + t], truth[t, 22:34, 10 + t : 16 + t] = thing, 1
    found = catalog.load("segmenters", "plate", Segmenter).masks(seen, {})
    between = np.stack([found[t, 23:29, 10 + t : 16 + t] for t in range(8)])
    assert between.mean() > 0.8 and not (found & (seen.robot > 127)).any()
    assert (found & truth).sum() / (found | truth).sum() > 0.8


def test_a_point_on_the_object_is_enough_to_follow_it() -> None:
    seen, truth = footage()
    found = catalog.load("segmenters", "track", Segmenter).masks(seen, {"points": {"one": [[26 / 48, 35 / 48]]}})
    assert (found & truth).sum() / (found | truth).sum() > 0.8 and not (found & (seen.robot > 127)).any()
    for wrong in ({"points": {"all": [[26, 35]]}}, {"points": {"all": []}}, {"points": {"other": [[0.5, 0.5]]}}):
        with pytest.raises(EdreamError, match="no first-frame box or points"):
            catalog.load("segmenters", "track", Segmenter).masks(seen, wrong)


def test_segmenters_say_what_they_lack(tmp_path: Path) -> None:
    seen, _ = footage()
    for name, words in (("track", "boxes"), ("precomputed", "masks.folder"), ("sam2", "masks.weights")):
        with pytest.raises(EdreamError, match=words):
            catalog.load("segmenters", name, Segmenter).masks(seen, {})
    with pytest.raises(EdreamError, match=r"one\.npz"):
        catalog.load("segmenters", "precomputed", Segmenter).masks(seen, {"folder": tmp_path})


def test_sam2_and_grounding_dino_are_read_from_a_local_folder_and_leave_the_robot_out(tmp_path: Path) -> None:
    """The weights are random, so only the way through is tested, not what is found."""
    pytest.importorskip("transformers", reason="the extra sam2 is not installed")
    from tests.tiny_sam2 import save_grounding, save_sam2

    seen, _ = footage()
    entry = catalog.load("segmenters", "sam2", Segmenter)
    save_sam2(tmp_path / "sam2")
    boxed = entry.masks(seen, {"weights": tmp_path, "boxes": {"all": [0.4, 0.6, 0.25, 0.2]}})
    with pytest.raises(EdreamError, match=r"masks\.options\.prompt"):
        entry.masks(seen, {"weights": tmp_path, "prompt": "a red box."})
    save_grounding(tmp_path / "grounding")
    worded = entry.masks(seen, {"weights": tmp_path, "prompt": "a red box."})
    for found in (boxed, worded):
        assert found.shape == seen.robot.shape and found.dtype == np.uint8 and 0.0 < found.mean() < 1.0
        assert not (found & (seen.robot > 127)).any()
    (tmp_path / "sam2" / "model.safetensors").write_bytes(b"nothing")
    with pytest.raises(EdreamError, match="no model that transformers reads"):
        entry.masks(seen, {"weights": tmp_path, "boxes": {"all": [0.4, 0.6, 0.25, 0.2]}})


def test_run_lengths_are_read_as_coco_writes_them(tmp_path: Path) -> None:
    seen, truth = footage()
    rows = []
    for mask in truth:
        flat = np.concatenate([[0], mask.T.ravel(), [2]])
        changes = np.flatnonzero(np.diff(flat) != 0)
        rows.append({"size": [48, 48], "counts": np.diff([0, *changes]).tolist()})
    import json

    for row, mask in zip(rows, truth, strict=True):
        row["counts"][-1] += mask.size - sum(row["counts"])
    (tmp_path / "one.json").write_text(json.dumps(rows))
    found = catalog.load("segmenters", "precomputed", Segmenter).masks(seen, {"folder": tmp_path})
    assert np.array_equal(found, truth & (seen.robot <= 127))
    texts = [{"size": [48, 48], "counts": _packed(row["counts"])} for row in rows]
    (tmp_path / "one.json").write_text(json.dumps(texts))
    assert np.array_equal(catalog.load("segmenters", "precomputed", Segmenter).masks(seen, {"folder": tmp_path}), found)


def _packed(counts: list[int]) -> str:
    """COCO's compressed counts, as its tools write them: five bits a character, from the fourth on differences to two before."""
    text = ""
    for i, count in enumerate(counts):
        value, more = count - (counts[i - 2] if i > 2 else 0), True
        while more:
            bits, value = value & 31, value >> 5
            more = value != (-1 if bits & 16 else 0)
            text += chr(48 + bits + (32 if more else 0))
    return text


def test_run_lengths_of_coco_tools_are_understood(tmp_path: Path) -> None:
    """`pycocotools.mask.encode` writes a 9 x 9 mask with rows 2 to 4, columns 3 to 7 as this text."""
    from edream.ingest.mask_file import read_masks

    mask = np.zeros((9, 9), bool)
    mask[2:5, 3:8] = True
    (tmp_path / "one.json").write_text('[{"size": [9, 9], "counts": "m03600000007"}, null]')
    (tmp_path / "two.json").write_text('[{"size": [9, 9], "counts": [29, 3, 6, 3, 6, 3, 6, 3, 6, 3, 13]}, null]')
    for name in ("one", "two"):
        found = read_masks(tmp_path, name)
        assert np.array_equal(found[0], mask) and not found[1].any()


@pytest.mark.parametrize(
    "text",
    [
        "[]",
        "[null]",
        "{}",
        '[{"size": [1000000, 1000000], "counts": [1000000000000]}]',
        '[{"size": [-4, -4], "counts": [16]}]',
        '[{"size": [4, 4], "counts": "oooooooooooooooooo"}]',
        '[{"size": [4, 4], "counts": "o"}]',
        '[{"size": [4, 4], "counts": [-1, 17]}]',
        '[{"size": [4], "counts": [16]}]',
        "nonsense",
    ],
)
def test_damaged_run_lengths_are_a_sentence(text: str, tmp_path: Path) -> None:
    from edream.ingest.mask_file import read_masks

    (tmp_path / "one.json").write_text(text)
    with pytest.raises(EdreamError, match="cannot be read"):
        read_masks(tmp_path, "one")


def test_mask_arrays_are_bounded_before_memory_is_taken(tmp_path: Path) -> None:
    import io
    import zipfile

    from edream.ingest.mask_file import read_arrays, read_masks

    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "|u1", "fortran_order": False, "shape": (10**6, 10**5, 10**5)})
    with zipfile.ZipFile(tmp_path / "one.npz", "w") as archive:
        archive.writestr("masks.npy", header.getvalue())
    with pytest.raises(EdreamError, match="bytes in all"):
        read_masks(tmp_path, "one")
    (tmp_path / "two.npz").write_bytes((tmp_path / "one.npz").read_bytes()[:40])
    with pytest.raises(EdreamError, match="cannot be read"):
        read_arrays(tmp_path / "two.npz")
