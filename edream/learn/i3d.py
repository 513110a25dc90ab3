"""I3D, the video network behind FVD: a plain module that takes its weights from a local file, so that nothing in the file runs."""

import math
from collections.abc import Sequence
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from edream.learn.checkpoint import fill, read_weights

SIDE = 224
SHORTEST = 10  # images of a clip
HINT = "expected the file that docs/dream.md says how to make"
MIXED = {  # channels of the branches: 1 x 1, to and of 3 x 3, to and of the second 3 x 3, after the pool
    "Mixed_3b": (192, (64, 96, 128, 16, 32, 32)),
    "Mixed_3c": (256, (128, 128, 192, 32, 96, 64)),
    "Mixed_4b": (480, (192, 96, 208, 16, 48, 64)),
    "Mixed_4c": (512, (160, 112, 224, 24, 64, 64)),
    "Mixed_4d": (512, (128, 128, 256, 24, 64, 64)),
    "Mixed_4e": (512, (112, 144, 288, 32, 64, 64)),
    "Mixed_4f": (528, (256, 160, 320, 32, 128, 128)),
    "Mixed_5b": (832, (256, 160, 320, 32, 128, 128)),
    "Mixed_5c": (832, (384, 192, 384, 48, 128, 128)),
}
POOLS = {  # before a layer: kernel and stride
    "Conv3d_2b_1x1": ((1, 3, 3), (1, 2, 2)),
    "Mixed_3b": ((1, 3, 3), (1, 2, 2)),
    "Mixed_4b": ((3, 3, 3), (2, 2, 2)),
    "Mixed_5b": ((2, 2, 2), (2, 2, 2)),
}


class Unit(nn.Module):
    """Convolution, batch norm and ReLU; padded as TensorFlow's SAME."""

    def __init__(self, inner: int, outer: int, kernel: int, stride: int = 1) -> None:
        super().__init__()
        self.conv3d = nn.Conv3d(inner, outer, kernel, stride, bias=False)
        self.bn = nn.BatchNorm3d(outer, eps=1e-3)

    def forward(self, x: Tensor) -> Tensor:
        return torch.relu(self.bn(self.conv3d(_padded(x, self.conv3d.kernel_size, self.conv3d.stride))))


class Mixed(nn.Module):
    """An Inception block."""

    def __init__(self, inner: int, widths: Sequence[int]) -> None:
        super().__init__()
        one, to_first, first, to_second, second, pooled = widths
        self.b0 = Unit(inner, one, 1)
        self.b1a, self.b1b = Unit(inner, to_first, 1), Unit(to_first, first, 3)
        self.b2a, self.b2b = Unit(inner, to_second, 1), Unit(to_second, second, 3)
        self.b3b = Unit(inner, pooled, 1)

    def forward(self, x: Tensor) -> Tensor:
        pooled = _pooled(x, (3, 3, 3), (1, 1, 1))
        return torch.cat([self.b0(x), self.b1b(self.b1a(x)), self.b2b(self.b2a(x)), self.b3b(pooled)], dim=1)


class I3d(nn.Module):
    """Inception I3D on RGB, 400 classes of Kinetics; its logits, averaged over time, are FVD's features.

    Names of the weights are those of the public PyTorch port. Source: Carreira, Zisserman, Quo Vadis, Action
    Recognition?, CVPR 2017.
    """

    def __init__(self) -> None:
        super().__init__()
        self.Conv3d_1a_7x7 = Unit(3, 64, 7, 2)
        self.Conv3d_2b_1x1, self.Conv3d_2c_3x3 = Unit(64, 64, 1), Unit(64, 192, 3)
        for name, (inner, widths) in MIXED.items():
            self.add_module(name, Mixed(inner, widths))
        self.logits = nn.ModuleDict({"conv3d": nn.Conv3d(1024, 400, 1)})

    def forward(self, clips: Float[Tensor, "N 3 T 224 224"]) -> Float[Tensor, "N 400"]:
        """Logits of clips -1..1."""
        x = self.Conv3d_1a_7x7(clips)
        for name in ("Conv3d_2b_1x1", "Conv3d_2c_3x3", *MIXED):
            if name in POOLS:
                x = _pooled(x, *POOLS[name])
            x = self.get_submodule(name)(x)
        x = functional.avg_pool3d(x, (2, 7, 7), stride=1)
        return self.logits["conv3d"](x).mean(dim=(2, 3, 4))


def features(network: I3d, clip: Float[Tensor, "T 3 H W"]) -> Float[Tensor, "400"]:
    """FVD's features of one clip -1..1, brought to 224 x 224."""
    large = functional.interpolate(clip, (SIDE, SIDE), mode="bilinear", align_corners=False)
    with torch.no_grad():
        return network(large.transpose(0, 1)[None])[0]


def read_i3d(path: Path) -> I3d:
    """The network with the weights of a .safetensors file.

    Raises:
        EdreamError: the file is missing, pickled or damaged, or holds other weights.
    """
    network = I3d()
    weights = read_weights(path)
    counters = {name: tensor for name, tensor in network.state_dict().items() if name.endswith("num_batches_tracked")}
    fill(network, counters | weights, str(path), HINT)  # older files lack them, and nothing reads them
    return network.eval().requires_grad_(False)


def _pooled(x: Tensor, kernel: Sequence[int], stride: Sequence[int]) -> Tensor:
    return functional.max_pool3d(_padded(x, kernel, stride), tuple(kernel), tuple(stride))


def _padded(x: Tensor, kernel: Sequence[int], stride: Sequence[int]) -> Tensor:
    """Zeros on both sides so that the output has ceil(size / stride) places, the odd one behind."""
    sides: list[int] = []
    for size, k, s in reversed(list(zip(x.shape[2:], kernel, stride, strict=True))):
        total = max((math.ceil(size / s) - 1) * s + k - size, 0)
        sides += [total // 2, total - total // 2]
    return functional.pad(x, sides)
