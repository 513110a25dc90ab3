"""Transformer layers in the form of DETR: places are added to queries and keys, never to values; norms come after."""

import math

import torch
from jaxtyping import Float
from torch import Tensor, nn


class Mixer(nn.Module):
    """Attention and feed-forward of one encoder layer."""

    def __init__(self, dim: int, heads: int, feedforward: int, dropout: float) -> None:
        super().__init__()
        self.attend = nn.MultiheadAttention(dim, heads, dropout, batch_first=True)
        self.forward_ = nn.Sequential(nn.Linear(dim, feedforward), nn.ReLU(), nn.Dropout(dropout), nn.Linear(feedforward, dim))
        self.norms = nn.ModuleList([nn.LayerNorm(dim), nn.LayerNorm(dim)])
        self.drop = nn.Dropout(dropout)

    def forward(self, x: Tensor, place: Tensor, padded: Tensor | None = None) -> Tensor:
        q = x + place
        found, _ = self.attend(q, q, x, key_padding_mask=padded, need_weights=False)
        x = self.norms[0](x + self.drop(found))
        return self.norms[1](x + self.drop(self.forward_(x)))


class Reader(nn.Module):
    """One decoder layer: queries look at one another, then at what the encoder made."""

    def __init__(self, dim: int, heads: int, feedforward: int, dropout: float) -> None:
        super().__init__()
        self.own = nn.MultiheadAttention(dim, heads, dropout, batch_first=True)
        self.cross = nn.MultiheadAttention(dim, heads, dropout, batch_first=True)
        self.forward_ = nn.Sequential(nn.Linear(dim, feedforward), nn.ReLU(), nn.Dropout(dropout), nn.Linear(feedforward, dim))
        self.norms = nn.ModuleList([nn.LayerNorm(dim) for _ in range(3)])
        self.drop = nn.Dropout(dropout)

    def forward(self, x: Tensor, query: Tensor, memory: Tensor, place: Tensor) -> Tensor:
        q = x + query
        x = self.norms[0](x + self.drop(self.own(q, q, x, need_weights=False)[0]))
        found, _ = self.cross(x + query, memory + place, memory, need_weights=False)
        x = self.norms[1](x + self.drop(found))
        return self.norms[2](x + self.drop(self.forward_(x)))


def waves(length: int, dim: int) -> Float[Tensor, "L D"]:
    """Sines and cosines of a place, as in "Attention is all you need"."""
    place = torch.arange(length, dtype=torch.float32)[:, None]
    rate = torch.exp(torch.arange(0, dim, 2, dtype=torch.float32) * (-math.log(10000.0) / dim))
    table = torch.zeros(length, dim)
    table[:, 0::2] = torch.sin(place * rate)
    table[:, 1::2] = torch.cos(place * rate[: dim // 2])
    return table


def waves2(height: int, width: int, dim: int) -> Float[Tensor, "HW D"]:
    """The same for places in an image: half of the numbers for the row, half for the column."""
    rows, columns = waves(height, dim // 2), waves(width, dim - dim // 2)
    grid = torch.cat([rows[:, None].expand(height, width, -1), columns[None].expand(height, width, -1)], dim=-1)
    return grid.reshape(height * width, dim)
