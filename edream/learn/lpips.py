"""LPIPS: the network of Zhang et al., its weights from a local file."""

from collections.abc import Mapping
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn.functional import interpolate

from edream.core.errors import EdreamError
from edream.learn.checkpoint import fill, read_weights

SHIFT, SCALE = (-0.030, -0.088, -0.188), (0.458, 0.448, 0.450)
HINT = "expected the file that docs/dream.md says how to make"
SMALLEST = 32  # pixel: below, AlexNet's last layers have nothing left to look at
# place of each layer in torchvision's `features`: a number of channels for a convolution with its ReLU, or None for a pool
ALEX = {0: 64, 2: None, 3: 192, 5: None, 6: 384, 8: 256, 10: 256}
ALEX_KERNELS = {0: (11, 4, 2), 3: (5, 1, 2), 6: (3, 1, 1), 8: (3, 1, 1), 10: (3, 1, 1)}
VGG = {0: 64, 2: 64, 4: None, 5: 128, 7: 128, 9: None, 10: 256, 12: 256, 14: 256, 16: None} | {
    **{17: 512, 19: 512, 21: 512, 23: None, 24: 512, 26: 512, 28: 512},
}
BACKBONES = {"AlexNet": (ALEX, (0, 3, 6, 8, 10)), "VGG16": (VGG, (2, 7, 14, 21, 28))}


class Lpips(nn.Module):
    """Features of a backbone after five of its ReLUs, each place's scaled to unit length; squared differences weighted by channel.

        d(x, y) = sum_l mean_hw w_l . (f_l(x) - f_l(y))^2

    Names of the weights are torchvision's for the backbone and those of the package `lpips` for the heads. Source: Zhang, Isola,
    Efros, Shechtman, Wang, The Unreasonable Effectiveness of Deep Features as a Perceptual Metric, CVPR 2018; version 0.1.
    """

    def __init__(self, backbone: str) -> None:
        super().__init__()
        self.backbone = backbone
        self.layers, self.taps = BACKBONES[backbone]
        self.features = nn.ModuleDict()
        inner = 3
        for place, width in self.layers.items():
            if width is not None:
                kernel, stride, padding = ALEX_KERNELS[place] if backbone == "AlexNet" else (3, 1, 1)
                self.features[str(place)] = nn.Conv2d(inner, width, kernel, stride, padding)
                inner = width
        widths = [self.layers[place] for place in self.taps]
        for number, width in enumerate(widths):
            self.add_module(f"lin{number}", nn.ModuleDict({"model": nn.ModuleDict({"1": nn.Conv2d(width or 0, 1, 1, bias=False)})}))
        self.register_buffer("shift", torch.tensor(SHIFT)[:, None, None], persistent=False)
        self.register_buffer("scale", torch.tensor(SCALE)[:, None, None], persistent=False)

    def maps(self, images: Float[Tensor, "N 3 H W"], others: Float[Tensor, "N 3 H W"]) -> list[Float[Tensor, "N h w"]]:
        """Distance of images -1..1 at each place of each layer."""
        found = []
        for number, (a, b) in enumerate(zip(self._features(images), self._features(others), strict=True)):
            head = self.get_submodule(f"lin{number}.model.1")
            found.append(head((_unit(a) - _unit(b)).square())[:, 0])
        return found

    def _features(self, images: Tensor) -> list[Tensor]:
        x = (images - self.get_buffer("shift")) / self.get_buffer("scale")
        found = []
        for place, width in self.layers.items():
            if width is None:
                x = nn.functional.max_pool2d(x, *((3, 2) if self.backbone == "AlexNet" else (2, 2)))
            else:
                x = torch.relu(self.features[str(place)](x))
                if place in self.taps:
                    found.append(x)
        return found


def distances(
    network: Lpips, images: Float[Tensor, "N 3 H W"], others: Float[Tensor, "N 3 H W"]
) -> tuple[Float[Tensor, "N"], Float[Tensor, "N H W"]]:
    """LPIPS of pairs of images -1..1, and the map of it over pixels (`spatial=True` of the package `lpips`).

    Raises:
        EdreamError: the images are too small for the backbone.
    """
    size = images.shape[-2:]
    if min(size) < SMALLEST:
        raise EdreamError(
            f"LPIPS needs images of at least {SMALLEST} pixels, not {size[0]} x {size[1]}; leave score.weights.lpips out."
        )
    with torch.no_grad():
        maps = network.maps(images, others)
        whole = torch.stack([one.mean(dim=(1, 2)) for one in maps]).sum(dim=0)
        large = [interpolate(one[:, None], size, mode="bilinear", align_corners=False)[:, 0] for one in maps]
    return whole, torch.stack(large).sum(dim=0)


def read_lpips(path: Path) -> Lpips:
    """The network with the weights of a .safetensors file; torchvision's classifier in it is left aside.

    Raises:
        EdreamError: the file is missing, pickled or damaged, or holds other weights.
    """
    weights = {name: tensor for name, tensor in read_weights(path).items() if not name.startswith("classifier.")}
    network = Lpips(_backbone(weights, path))
    fill(network, weights, str(path), HINT)
    return network.eval().requires_grad_(False)


def _backbone(weights: Mapping[str, Tensor], path: Path) -> str:
    first = weights.get("features.0.weight")
    for name, shape in (("AlexNet", (64, 3, 11, 11)), ("VGG16", (64, 3, 3, 3))):
        if first is not None and tuple(first.shape) == shape:
            return name
    raise EdreamError(f"{path} holds neither AlexNet's nor VGG16's features; {HINT}.")


def _unit(x: Tensor) -> Tensor:
    return x / (x.square().sum(dim=1, keepdim=True).sqrt() + 1e-10)
