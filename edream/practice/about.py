"""What must be known of a trained policy besides its weights: sizes, cameras, scales; the same in the store and in a bundle."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import torch

from edream import catalog
from edream.core.stage import Artifact
from edream.learn.checkpoint import fill
from edream.learn.policy import FittedPolicy, Policy, PolicyShape, Scale, Seen

WEIGHTS, ABOUT, HISTORY = "policy.safetensors", "policy.json", "history.json"


@dataclass(frozen=True, eq=False)
class PolicyAbout:
    """A policy's form and its units.

    Attributes:
        kind: entry of `edream/policies/`.
        options: the entry's own.
        shape: numbers its network is built for.
        order: joints in the order of joints and actions.
        cameras: names in the order of its views.
        rate: control steps a second [Hz].
        stride: actions of a chunk that are executed before the next is asked for.
        ensemble: m of temporal ensembling, whose weights are exp(-m i), i = 0 the oldest; None to execute the newest chunk alone.
        joints, actions, state: scales.
        spread: mean absolute error on held-out demonstrations, in normalised units: the b of the Laplace likelihood.
    """

    kind: str
    options: Mapping[str, Any]
    shape: PolicyShape
    order: tuple[str, ...]
    cameras: tuple[str, ...]
    rate: float
    stride: int
    ensemble: float | None
    joints: Scale
    actions: Scale
    state: Scale
    spread: float = 0.1

    @property
    def chunk(self) -> int:
        """Actions predicted at once, H."""
        return self.shape.chunk

    def seen(self, joints: np.ndarray, images: np.ndarray, state: np.ndarray) -> Seen:
        """Rows of observations, SI and uint8, as the network takes them."""
        return Seen(
            torch.from_numpy(self.joints.into(joints)),
            torch.from_numpy(np.ascontiguousarray(images)),
            torch.from_numpy(self.state.into(state)),
        )

    def network(self, weights: Mapping[str, torch.Tensor] | None = None, seed: int = 0) -> FittedPolicy:
        """The network, with weights drawn from `seed` or as given.

        Raises:
            EdreamError: an option is wrong, or the weights do not fit.
        """
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            network = catalog.load("policies", self.kind, Policy).build(self.shape, self.options)
        if weights is not None:
            fill(network, weights, WEIGHTS)
        return network

    def plain(self) -> dict[str, Any]:
        """As JSON has it."""
        values = {
            name: getattr(self, name) for name in ("kind", "options", "order", "cameras", "rate", "stride", "ensemble", "spread")
        }
        scales = {
            name: {"mean": getattr(self, name).mean.tolist(), "spread": getattr(self, name).spread.tolist()}
            for name in ("joints", "actions", "state")
        }
        return values | {"shape": asdict(self.shape), "scales": scales}

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> "PolicyAbout":
        """From JSON that `plain` made."""
        scales = {
            name: Scale(np.array(one["mean"], np.float32), np.array(one["spread"], np.float32))
            for name, one in values["scales"].items()
        }
        return cls(
            kind=values["kind"],
            options=values["options"],
            shape=PolicyShape(**values["shape"]),
            order=tuple(values["order"]),
            cameras=tuple(values["cameras"]),
            rate=float(values["rate"]),
            stride=int(values["stride"]),
            ensemble=values["ensemble"],
            spread=float(values["spread"]),
            **scales,
        )


def rounds_of(policy: Artifact) -> Sequence[Mapping[str, Any]]:
    """The rounds of trials that a policy in an artifact learned from, a row each; none for a supervised one."""
    return policy[HISTORY] if HISTORY in policy else []  # noqa: SIM401 - an artifact has no default
