"""LPIPS and FVD: their networks, and weights files that fit or are refused. The weights are random; only shapes are true."""

from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import save_file

from edream.core.errors import EdreamError
from edream.learn.i3d import I3d, read_i3d
from edream.learn.lpips import BACKBONES, Lpips, distances, read_lpips
from edream.vision.features import frechet
from edream.vision.judging import ready_metrics, scores


@pytest.fixture(autouse=True)
def one_thread() -> None:
    torch.set_num_threads(1)


def drawn(network: torch.nn.Module, seed: int = 0) -> dict[str, torch.Tensor]:
    """Random weights; heads and variances above 0, as trained ones are."""
    chance = torch.Generator().manual_seed(seed)
    found = {}
    for name, tensor in network.state_dict().items():
        if not tensor.is_floating_point():
            continue
        spread = (2.0 / max(tensor[0].numel(), 1)) ** 0.5 if tensor.ndim > 1 else 0.1
        value = spread * torch.randn(tensor.shape, generator=chance)
        found[name] = value.abs() + 0.5 if name.endswith(("running_var", "bn.weight")) else value.abs() if "lin" in name else value
    return found


@pytest.fixture(scope="module")
def alex(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("lpips") / "alex.safetensors"
    save_file(drawn(Lpips("AlexNet")), path)
    return path


@pytest.fixture(scope="module")
def i3d(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("i3d") / "i3d.safetensors"
    save_file(drawn(I3d()), path)
    return path


def clips(count: int, frames: int, size: int, noise: float) -> np.ndarray:
    still = np.random.default_rng(0).integers(60, 200, (count, 1, size // 8, size // 8, 3)).repeat(8, 2).repeat(8, 3)
    shaken = still + np.random.default_rng(1).normal(0, noise, (count, frames, size, size, 3))
    return np.clip(shaken, 0, 255).astype(np.uint8)


@pytest.mark.parametrize("backbone", list(BACKBONES))
def test_lpips_weighs_squared_differences_of_unit_features_after_five_relus(backbone: str) -> None:
    network = Lpips(backbone)
    network.load_state_dict(drawn(network))
    images, others = torch.rand(2, 2, 3, 64, 64, generator=torch.Generator().manual_seed(1)) * 2 - 1
    with torch.no_grad():
        whole, table = distances(network, images, others)
        expected = torch.zeros(2)
        seen = [(x - network.shift) / network.scale for x in (images, others)]
        number = 0
        for place, width in network.layers.items():
            if width is None:
                seen = [torch.nn.functional.max_pool2d(x, 3 if backbone == "AlexNet" else 2, 2) for x in seen]
                continue
            seen = [torch.relu(network.features[str(place)](x)) for x in seen]
            if place in network.taps:
                a, b = (x / x.norm(dim=1, keepdim=True).clamp(min=1e-10) for x in seen)
                weights = network.state_dict()[f"lin{number}.model.1.weight"][0]
                expected += ((a - b).square() * weights).sum(dim=1).mean(dim=(1, 2))
                number += 1
    assert number == 5 and torch.allclose(whole, expected, rtol=1e-4) and (whole > 0).all()
    assert table.shape == (2, 64, 64) and torch.allclose(table.mean(dim=(1, 2)), whole, rtol=0.05)
    assert not distances(network, images, images)[0].any()


def test_lpips_is_read_with_torchvisions_classifier_in_the_file_and_scores_regions(alex: Path, tmp_path: Path) -> None:
    from safetensors.torch import load_file

    path = tmp_path / "whole.safetensors"
    save_file(load_file(alex) | {"classifier.1.weight": torch.zeros(4, 4)}, path)
    metrics = ready_metrics(("lpips", "psnr"), {"lpips": path})
    real, made = clips(1, 2, 64, 0.0), clips(1, 2, 64, 30.0)
    made[:, :, :, 32:] = real[:, :, :, 32:]
    left = np.zeros(real.shape[:4], bool)
    left[..., :24] = True
    where = {"all": np.ones_like(left), "object": left, "robot": np.zeros_like(left), "not object": ~left, "background": ~left}
    found = scores(made, real, where, metrics)["lpips"]
    assert found["object"] > found["all"] > 0.0 and found["robot"] is None
    assert scores(real, real, where, metrics)["lpips"]["all"] == 0.0
    assert metrics["lpips"].about == "LPIPS 0.1 on AlexNet"


def test_images_too_small_for_lpips_are_a_sentence(alex: Path) -> None:
    with pytest.raises(EdreamError, match="at least 32 pixels"):
        distances(read_lpips(alex), torch.zeros(1, 3, 16, 16), torch.zeros(1, 3, 16, 16))


def test_fvd_is_nothing_between_equal_clips_and_wants_ten_images(i3d: Path) -> None:
    metric = ready_metrics(("fvd",), {"fvd": i3d})["fvd"]
    real, made = clips(2, 10, 32, 0.0), clips(2, 10, 32, 60.0)
    where = np.ones(real.shape[:4], bool)
    same, apart = metric.score(real, real, where), metric.score(made, real, where)
    assert same is not None and apart is not None and abs(same) < 1e-3 * apart
    assert metric.score(real[:, :9], real[:, :9], where[:, :9]) is None


def test_the_frechet_distance_is_that_of_two_gaussians() -> None:
    rng = np.random.default_rng(4)
    a, b = rng.normal(0, 1, (20000, 2)) * [1.0, 2.0], rng.normal(0, 1, (20000, 2)) * [3.0, 2.0] + [1.0, 0.0]
    assert frechet(a, b, 0.0) == pytest.approx(1.0 + (3.0 - 1.0) ** 2, abs=0.15)


def test_i3ds_counters_may_be_in_the_file_or_not(i3d: Path, tmp_path: Path) -> None:
    from safetensors.torch import load_file

    with_counters = I3d().state_dict() | load_file(i3d)
    save_file(with_counters, tmp_path / "whole.safetensors")
    a, b = read_i3d(i3d).state_dict(), read_i3d(tmp_path / "whole.safetensors").state_dict()
    assert all(torch.equal(a[name], b[name]) for name in load_file(i3d))


@pytest.mark.parametrize("reader", [read_lpips, read_i3d])
def test_weights_that_are_pickled_damaged_missing_or_anothers_are_refused_in_a_sentence(reader, alex: Path, tmp_path: Path) -> None:
    pickled, torn, other = tmp_path / "a.pt", tmp_path / "b.safetensors", tmp_path / "c.safetensors"
    torch.save({"features.0.weight": torch.zeros(3)}, pickled)
    torn.write_bytes(alex.read_bytes()[:5000])
    save_file({"features.0.weight": torch.zeros(64, 3, 11, 11), "Conv3d_1a_7x7.conv3d.weight": torch.zeros(64, 3, 7, 7, 7)}, other)
    for path, words in ((pickled, "pickled"), (torn, "damaged"), (tmp_path / "no", "no weights"), (other, "does not fit")):
        with pytest.raises(EdreamError, match=words) as caught:
            reader(path)
        assert "\n" not in str(caught.value)


def test_learned_metrics_without_weights_are_left_out_and_told_when_asked_for(alex: Path) -> None:
    assert "lpips" not in ready_metrics((), {}) and "fvd" not in ready_metrics((), {}) and "psnr" in ready_metrics((), {})
    with pytest.raises(EdreamError, match=r"score\.weights\.lpips"):
        ready_metrics(("lpips",), {})
    with pytest.raises(EdreamError, match="'lpips'"):
        ready_metrics((), {"lpisp": alex})
