"""Backbones: what turns an image into a coarse and a fine map of features. Weights start from chance; nothing is downloaded."""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor, nn

from edream.core.errors import unknown_name

NAMES = ("small_conv", "resnet18")


class SmallConv(nn.Module):
    """Strided convolutions for CPUs: each stage halves the image, at a few thousand weights each.

    Attributes:
        channels: of the coarse map.
        fine_channels: of the fine map, which is a quarter of the image's size.
    """

    def __init__(self, widths: Sequence[int] = (16, 32, 48, 64)) -> None:
        super().__init__()
        stages = [
            self._stage(before, width, 5 if number == 0 else 3, 2)
            for number, (before, width) in enumerate(zip((3, *widths), widths, strict=False))
        ]
        fine = min(2, len(widths))
        self.fine = nn.Sequential(*stages[:fine], self._stage(widths[fine - 1], widths[fine - 1], 3, 1))
        self.body = nn.Sequential(*stages[fine:])
        self.channels, self.fine_channels = widths[-1], widths[fine - 1]

    def forward(self, images: Float[Tensor, "B 3 H W"]) -> tuple[Float[Tensor, "B C h w"], Float[Tensor, "B F hf wf"]]:
        fine = self.fine(images)
        return self.body(fine), fine

    def _stage(self, before: int, width: int, kernel: int, stride: int) -> nn.Module:
        return nn.Sequential(
            nn.Conv2d(before, width, kernel, stride, kernel // 2), nn.GroupNorm(max(1, width // 8), width), nn.ReLU()
        )


class Block(nn.Module):
    """Two convolutions around which the input is carried on."""

    def __init__(self, before: int, width: int, stride: int) -> None:
        super().__init__()
        self.body = nn.Sequential(
            nn.Conv2d(before, width, 3, stride, 1, bias=False),
            nn.GroupNorm(width // 16, width),
            nn.ReLU(),
            nn.Conv2d(width, width, 3, 1, 1, bias=False),
            nn.GroupNorm(width // 16, width),
        )
        same = stride == 1 and before == width
        self.carry = (
            nn.Identity()
            if same
            else nn.Sequential(nn.Conv2d(before, width, 1, stride, bias=False), nn.GroupNorm(width // 16, width))
        )

    def forward(self, x: Tensor) -> Tensor:
        return torch.relu(self.body(x) + self.carry(x))


class ResNet18(nn.Module):
    """The eighteen layers of He et al. (2016), with group norm, which suits small batches, in place of batch norm."""

    def __init__(self) -> None:
        super().__init__()
        head = [nn.Conv2d(3, 64, 7, 2, 3, bias=False), nn.GroupNorm(4, 64), nn.ReLU(), nn.MaxPool2d(3, 2, 1)]
        plan = [(64, 64, 1), (64, 64, 1), (64, 128, 2), (128, 128, 1), (128, 256, 2), (256, 256, 1), (256, 512, 2), (512, 512, 1)]
        self.fine = nn.Sequential(*head, *(Block(*one) for one in plan[:4]))
        self.body = nn.Sequential(*(Block(*one) for one in plan[4:]))
        self.channels, self.fine_channels = 512, 128

    def forward(self, images: Float[Tensor, "B 3 H W"]) -> tuple[Float[Tensor, "B C h w"], Float[Tensor, "B F hf wf"]]:
        fine = self.fine(images)
        return self.body(fine), fine


def backbone(name: str, widths: Sequence[int]) -> SmallConv | ResNet18:
    """A backbone by its name.

    Raises:
        EdreamError: there is none of that name.
    """
    if name == "small_conv":
        return SmallConv(tuple(widths))
    if name == "resnet18":
        return ResNet18()
    raise unknown_name("backbone", name, NAMES)


class Keypoints(nn.Module):
    """Where in an image each of K things is: the centre of mass of K soft maps, -1..1, two numbers each.

    Finer than the map's own grid, which is what a gripper needs of a small image. Source: Levine et al., JMLR 17(39), 2016.
    """

    def __init__(self, channels: int, count: int) -> None:
        super().__init__()
        self.maps = nn.Conv2d(channels, count, 1)
        self.sharpness = nn.Parameter(torch.ones(count))

    def forward(self, features: Float[Tensor, "B C h w"]) -> Float[Tensor, "B 2K"]:
        h, w = features.shape[-2:]
        maps = self.maps(features).flatten(2) * self.sharpness[:, None]
        weight = torch.softmax(maps, dim=-1).unflatten(-1, (h, w))
        rows = torch.linspace(-1.0, 1.0, h, device=features.device, dtype=weight.dtype)
        columns = torch.linspace(-1.0, 1.0, w, device=features.device, dtype=weight.dtype)
        return torch.cat([(weight.sum(3) * rows).sum(2), (weight.sum(2) * columns).sum(2)], dim=1)
