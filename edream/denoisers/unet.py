"""A space-time UNet, factorised: layers in space work on each frame, layers in time look back only."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional
from torch.utils.checkpoint import checkpoint

from edream.core.errors import EdreamError, unknown_name
from edream.learn.denoiser import Denoiser, FittedDenoiser, Shown, State

WINDOW = 8  # frames that attention in time sees, its own included


class FrameBlock(nn.Module):
    """A residual block on each frame, its middle scaled and shifted by the frame's noise level."""

    def __init__(self, inner: int, outer: int, embedded: int) -> None:
        super().__init__()
        self.first, self.second = nn.GroupNorm(8, inner), nn.GroupNorm(8, outer)
        self.one, self.two = nn.Conv2d(inner, outer, 3, padding=1), nn.Conv2d(outer, outer, 3, padding=1)
        self.level = nn.Linear(embedded, 2 * outer)
        self.skip = nn.Conv2d(inner, outer, 1) if inner != outer else nn.Identity()

    def forward(self, x: Tensor, level: Tensor) -> Tensor:
        b, t = x.shape[:2]
        y = x.flatten(0, 1)  # (B T, C, h, w)
        z = self.one(functional.silu(self.first(y)))
        scale, shift = self.level(level).flatten(0, 1)[:, :, None, None].chunk(2, dim=1)
        z = self.two(functional.silu(self.second(z) * (1.0 + scale) + shift))
        return (self.skip(y) + z).unflatten(0, (b, t))


class PastConvolution(nn.Module):
    """A convolution over this frame and the two before, zero at first so that a new network treats frames alone."""

    def __init__(self, width: int, name: str) -> None:
        super().__init__()
        self.name = name
        self.norm = nn.GroupNorm(8, width)
        self.taps = nn.Conv3d(width, width, (3, 1, 1), bias=False)
        nn.init.zeros_(self.taps.weight)

    def forward(self, x: Tensor, state: State | None) -> Tensor:
        b, t, c, h, w = x.shape
        y = functional.silu(self.norm(x.flatten(0, 1))).unflatten(0, (b, t))
        past = None if state is None else state.get(self.name)
        y = torch.cat([y.new_zeros(b, 2, c, h, w) if past is None else past, y], dim=1)
        if state is not None:
            state[self.name] = y[:, -2:].detach()
        return x + self.taps(y.transpose(1, 2)).transpose(1, 2)


class SpaceAttention(nn.Module):
    """Attention among the places of one frame."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.heads, self.norm = heads, nn.GroupNorm(8, width)
        self.qkv, self.out = nn.Linear(width, 3 * width), nn.Linear(width, width)
        nn.init.zeros_(self.out.weight)
        nn.init.zeros_(self.out.bias)

    def forward(self, x: Tensor) -> Tensor:
        b, t, c, h, w = x.shape
        y = self.norm(x.flatten(0, 1)).flatten(2).transpose(1, 2)  # (B T, h w, C)
        q, k, v = self.qkv(y).unflatten(-1, (3, self.heads, c // self.heads)).permute(2, 0, 3, 1, 4)
        z = functional.scaled_dot_product_attention(q, k, v).transpose(1, 2).flatten(2)
        return x + self.out(z).transpose(1, 2).unflatten(-1, (h, w)).unflatten(0, (b, t))


class PastAttention(nn.Module):
    """Attention of each place to itself in this frame and the `WINDOW` - 1 before, with a learned bias by distance in time."""

    def __init__(self, width: int, heads: int, name: str) -> None:
        super().__init__()
        self.heads, self.name, self.norm = heads, name, nn.GroupNorm(8, width)
        self.qkv, self.out = nn.Linear(width, 3 * width), nn.Linear(width, width)
        self.bias = nn.Parameter(torch.zeros(heads, WINDOW))
        nn.init.zeros_(self.out.weight)
        nn.init.zeros_(self.out.bias)

    def forward(self, x: Tensor, state: State | None) -> Tensor:
        b, t, c, h, w = x.shape
        y = self.norm(x.flatten(0, 1)).unflatten(0, (b, t)).permute(0, 3, 4, 1, 2).reshape(b * h * w, t, c)
        q, k, v = self.qkv(y).unflatten(-1, (3, self.heads, c // self.heads)).permute(2, 0, 3, 1, 4)  # (B h w, heads, T, c)
        if state is not None:
            if self.name in state:
                k, v = torch.cat([state[self.name][0], k], dim=2), torch.cat([state[self.name][1], v], dim=2)
            state[self.name] = torch.stack([k, v])[:, :, :, -(WINDOW - 1) :].detach()
        back = torch.arange(k.shape[2] - t, k.shape[2], device=x.device)[:, None] - torch.arange(k.shape[2], device=x.device)
        near = self.bias[:, back.clamp(0, WINDOW - 1)].masked_fill((back < 0) | (back >= WINDOW), float("-inf"))
        z = functional.scaled_dot_product_attention(q, k, v, attn_mask=near.to(q.dtype)).transpose(1, 2).flatten(2)
        return x + self.out(z).reshape(b, h, w, t, c).permute(0, 3, 4, 1, 2)


class Level(nn.Module):
    """What happens at one resolution: residual blocks, each followed by a look at the past, and attention where asked for."""

    def __init__(self, inner: int, width: int, embedded: int, blocks: int, heads: int, name: str) -> None:
        super().__init__()
        self.blocks = nn.ModuleList([FrameBlock(inner if i == 0 else width, width, embedded) for i in range(blocks)])
        self.past = nn.ModuleList([PastConvolution(width, f"{name}.past{i}") for i in range(blocks)])
        self.space = SpaceAttention(width, heads) if heads else None
        self.time = PastAttention(width, heads, f"{name}.time") if heads else None

    def forward(self, x: Tensor, level: Tensor, state: State | None) -> Tensor:
        for block, past in zip(self.blocks, self.past, strict=True):
            x = past(block(x, level), state)
        if self.space is not None and self.time is not None:
            x = self.time(self.space(x), state)
        return x


class UNet(FittedDenoiser):
    """The network; see `SpaceTimeUNet` for its options."""

    streams = True

    def __init__(self, channels: int, shown: int, widths: tuple[int, ...], blocks: int, heads: int, save_memory: bool) -> None:
        super().__init__()
        self.save_memory, embedded = save_memory, 4 * widths[0]
        self.level = nn.Sequential(nn.Linear(32, embedded), nn.SiLU(), nn.Linear(embedded, embedded), nn.SiLU())
        self.enter = nn.Conv2d(channels + shown, widths[0], 3, padding=1)
        last = len(widths) - 1
        before = (widths[0], *widths[:-1])
        self.down = nn.ModuleList(
            [Level(before[i], w, embedded, blocks, heads if i == last else 0, f"down{i}") for i, w in enumerate(widths)]
        )
        self.shrink = nn.ModuleList([nn.Conv2d(w, w, 3, stride=2, padding=1) for w in widths[:-1]])
        self.up = nn.ModuleList([Level(widths[i + 1] + w, w, embedded, blocks, 0, f"up{i}") for i, w in enumerate(widths[:-1])])
        self.norm, self.leave = nn.GroupNorm(8, widths[0]), nn.Conv2d(widths[0], channels, 3, padding=1)
        nn.init.zeros_(self.leave.weight)
        nn.init.zeros_(self.leave.bias)  # type: ignore[arg-type]

    def forward(self, x: Tensor, t: Tensor, shown: Shown, state: State | None = None) -> Tensor:
        b, frames = x.shape[:2]
        waves = torch.exp(torch.linspace(0.0, 6.0, 16, device=x.device)) * t[..., None]  # (B, T, 16)
        level = self.level(torch.cat([waves.sin(), waves.cos()], dim=-1).to(x.dtype))
        y = self.enter(torch.cat([x, shown.latents, shown.masks], dim=2).flatten(0, 1)).unflatten(0, (b, frames))
        kept = []
        for i, stage in enumerate(self.down):
            y = self._run(stage, y, level, state)
            if i < len(self.shrink):
                kept.append(y)
                y = self.shrink[i](y.flatten(0, 1)).unflatten(0, (b, frames))
        for i in reversed(range(len(self.up))):
            large = functional.interpolate(y.flatten(0, 1), scale_factor=2.0, mode="nearest").unflatten(0, (b, frames))
            y = self._run(self.up[i], torch.cat([large, kept[i]], dim=2), level, state)
        return self.leave(functional.silu(self.norm(y.flatten(0, 1)))).unflatten(0, (b, frames))

    def _run(self, stage: nn.Module, x: Tensor, level: Tensor, state: State | None) -> Tensor:
        if self.save_memory and self.training and state is None:
            return checkpoint(stage, x, level, None, use_reentrant=False)  # type: ignore[return-value]
        return stage(x, level, state)


class SpaceTimeUNet(Denoiser):
    """The project's own network.

    Options: `widths`, channels at each resolution (multiples of 8); `blocks` at each resolution; `heads` of attention at the
    lowest; `save_memory`, gradient checkpointing. The same code serves for widths of 32 and of 320. Nothing in it looks ahead, so
    a clip of any length, and one frame after the other, give the same images.
    """

    name = "unet"
    summary = "own factorised space-time UNet, causal in time, any number of frames"

    def build(self, channels: int, shown: int, options: Mapping[str, Any], weights: Path | None) -> UNet:
        chosen = {"widths": (64, 96, 128), "blocks": 1, "heads": 4, "save_memory": False}
        for name in options:
            if name not in chosen:
                raise unknown_name("option of denoiser 'unet':", name, chosen)
        chosen |= options
        widths = tuple(int(w) for w in chosen["widths"])
        if not widths or any(w % 8 or w < 8 for w in widths) or widths[-1] % int(chosen["heads"]):
            raise EdreamError(
                f"dream.denoiser.options.widths is {list(widths)}; expected multiples of 8, the last one of the heads too."
            )
        if weights is not None:
            raise EdreamError("Denoiser 'unet' has no pretrained weights; dream.denoiser.weights is for 'svd'.")
        return UNet(channels, shown, widths, int(chosen["blocks"]), int(chosen["heads"]), bool(chosen["save_memory"]))


ENTRY = SpaceTimeUNet()
