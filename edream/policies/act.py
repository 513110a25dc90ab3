"""ACT: action chunks from a conditional variational autoencoder with a transformer. Zhao et al., RSS 2023, arXiv:2304.13705."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from edream.core.errors import EdreamError, unknown_name
from edream.learn.attention import Mixer, Reader, waves, waves2
from edream.learn.backbone import Keypoints, backbone
from edream.learn.policy import FittedPolicy, Policy, PolicyShape, Seen, masked_l1

LEVEL, SPREAD = 127.5, 64.0  # of image values


@dataclass(frozen=True)
class ActOptions:
    """The network's size. The paper's: dim 512, feedforward 3200, heads 8, encoder 4, decoder 1, posterior 4, latent 32, resnet18.

    Attributes:
        dim, heads, feedforward: of the transformer.
        encoder, decoder, posterior: layers. The published code uses its first decoder layer only, hence 1.
        latent: size of z.
        kl: weight of the divergence of z's posterior from N(0, I).
        dropout: share of numbers left out in training.
        backbone: small_conv or resnet18.
        widths: channels of small_conv's stages, each of which halves the image.
        keypoints: soft image places that are handed on as one more token a view; 0 for the paper's form.
    """

    dim: int = 64
    heads: int = 4
    feedforward: int = 256
    encoder: int = 2
    decoder: int = 1
    posterior: int = 1
    latent: int = 16
    kl: float = 10.0
    dropout: float = 0.0
    backbone: str = "small_conv"
    widths: tuple[int, ...] = (16, 32, 48, 64)
    keypoints: int = 16

    @classmethod
    def of(cls, options: Mapping[str, Any]) -> "ActOptions":
        """From the config.

        Raises:
            EdreamError: an option is unknown or out of its range.
        """
        known = {field.name: field for field in fields(cls)}
        for name in options:
            if name not in known:
                raise unknown_name("option of act", str(name), known)
        given: dict[str, Any] = {str(name): tuple(value) if name == "widths" else value for name, value in options.items()}
        chosen = cls(**given)
        if chosen.dim % chosen.heads or chosen.dim % 4 or min(chosen.dim, chosen.encoder, chosen.decoder, chosen.latent) < 1:
            raise EdreamError(
                f"act has dim {chosen.dim}, heads {chosen.heads}, encoder {chosen.encoder}, decoder {chosen.decoder}, latent "
                f"{chosen.latent}; expected a dim that 4 and heads divide, and at least 1 of the others."
            )
        return chosen


class ActNetwork(FittedPolicy):
    """Posterior q(z | joints, actions), encoder over z, joints, state and image features, decoder with one query an action."""

    grid: Tensor
    clock: Tensor

    def __init__(self, shape: PolicyShape, options: ActOptions) -> None:
        super().__init__()
        dim, layer = options.dim, (options.dim, options.heads, options.feedforward, options.dropout)
        self.shape, self.latent, self.kl = shape, options.latent, options.kl
        self.first = nn.Parameter(torch.randn(1, 1, dim) * 0.02)
        self.posterior_joints, self.posterior_actions = nn.Linear(shape.actions, dim), nn.Linear(shape.actions, dim)
        self.posterior = nn.ModuleList([Mixer(*layer) for _ in range(options.posterior)])
        self.moments = nn.Linear(dim, 2 * options.latent)
        self.from_z, self.from_joints = nn.Linear(options.latent, dim), nn.Linear(shape.actions, dim)
        self.from_state = nn.Linear(shape.state, dim) if shape.state else None
        extra = 2 + (1 if shape.state else 0)
        if shape.cameras:
            self.eye = backbone(options.backbone, options.widths)
            self.project = nn.Conv2d(self.eye.channels, dim, 1)
            with torch.no_grad():
                size = self.eye(torch.zeros(1, 3, shape.height, shape.width))[0].shape[-2:]
            self.register_buffer("grid", waves2(size[0], size[1], dim), persistent=False)
            self.view = nn.Parameter(torch.randn(shape.cameras, 1, dim) * 0.02)
            self.points = Keypoints(self.eye.fine_channels, options.keypoints) if options.keypoints else None
            self.from_points = nn.Linear(2 * options.keypoints, dim) if options.keypoints else None
            extra += shape.cameras if options.keypoints else 0
        self.places = nn.Parameter(torch.randn(1, extra, dim) * 0.02)
        self.encoder = nn.ModuleList([Mixer(*layer) for _ in range(options.encoder)])
        self.queries = nn.Parameter(torch.randn(1, shape.chunk, dim) * 0.02)
        self.register_buffer("clock", waves(shape.chunk + 2, dim), persistent=False)
        self.decoder = nn.ModuleList([Reader(*layer) for _ in range(options.decoder)])
        self.head = nn.Linear(dim, shape.actions)

    def chunk(self, seen: Seen, z: Float[Tensor, "B Z"] | None = None) -> Float[Tensor, "B H A"]:
        if z is None:
            z = torch.zeros(len(seen), self.latent, device=seen.joints.device)
        tokens, places = self._tokens(seen, z)
        for layer in self.encoder:
            tokens = layer(tokens, places)
        out = torch.zeros(len(seen), self.shape.chunk, tokens.shape[-1], device=tokens.device, dtype=tokens.dtype)
        query = self.queries + self.clock[: self.shape.chunk]
        for layer in self.decoder:
            out = layer(out, query.expand_as(out), tokens, places)
        return self.head(out)

    def _tokens(self, seen: Seen, z: Tensor) -> tuple[Float[Tensor, "B N D"], Float[Tensor, "1 N D"]]:
        single = [self.from_z(z), self.from_joints(seen.joints)]
        if self.from_state is not None:
            single.append(self.from_state(seen.state))
        if not self.shape.cameras:
            return torch.stack(single, dim=1), self.places
        b, v = seen.images.shape[:2]
        images = (seen.images.flatten(0, 1).movedim(-1, 1).float() - LEVEL) / SPREAD  # (B V, 3, H, W)
        features, fine = self.eye(images)
        tokens = self.project(features).flatten(2).transpose(1, 2).unflatten(0, (b, v)).flatten(1, 2)  # (B, V h w, D)
        places = (self.grid + self.view).flatten(0, 1)[None]
        if self.points is not None and self.from_points is not None:
            found = self.from_points(self.points(fine)).unflatten(0, (b, v))
            single += list(found.unbind(dim=1))
        return torch.cat([torch.stack(single, dim=1), tokens], dim=1), torch.cat([self.places, places], dim=1)

    def style(self, seen: Seen, actions: Tensor, valid: Tensor) -> tuple[Float[Tensor, "B Z"], Float[Tensor, "B Z"]]:
        """Mean and log-variance of z given what was done."""
        x = torch.cat(
            [self.first.expand(len(seen), 1, -1), self.posterior_joints(seen.joints)[:, None], self.posterior_actions(actions)],
            dim=1,
        )
        padded = torch.cat([torch.zeros_like(valid[:, :1]).expand(-1, 2), ~valid], dim=1)
        for layer in self.posterior:
            x = layer(x, self.clock, padded)
        mean, log_variance = self.moments(x[:, 0]).chunk(2, dim=-1)
        return mean, log_variance.clamp(-10.0, 10.0)

    def loss(
        self, seen: Seen, actions: Float[Tensor, "B H A"], valid: Bool[Tensor, "B H"], chance: torch.Generator
    ) -> Float[Tensor, ""]:
        mean, log_variance = self.style(seen, actions, valid)
        noise = torch.randn(mean.shape, generator=chance).to(mean.device)
        made = self.chunk(seen, mean + noise * torch.exp(0.5 * log_variance))
        divergence = 0.5 * (mean**2 + log_variance.exp() - log_variance - 1.0).sum(dim=-1).mean()
        return masked_l1(made, actions, valid) + self.kl * divergence


class Act(Policy):
    """Action chunking with transformers."""

    name = "act"
    summary = "ACT: chunks of actions from a conditional variational autoencoder; L1 on the steps that are no padding."

    def build(self, shape: PolicyShape, options: Mapping[str, Any]) -> ActNetwork:
        return ActNetwork(shape, ActOptions.of(options))


ENTRY = Act()
