"""The one training loop: Adam, warm-up and cosine, averaged weights, and a state that goes on exactly where it stopped."""

import math
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import nullcontext
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
import torch
from torch import Tensor, nn
from torch.optim.swa_utils import get_ema_multi_avg_fn

from edream.core.errors import EdreamError
from edream.learn import ranks
from edream.learn.checkpoint import fill

State = dict[str, np.ndarray]
T = TypeVar("T")
WEIGHTS, AVERAGE, FIRST, SECOND = "weights/", "average/", "first/", "second/"


@dataclass(frozen=True)
class Schedule:
    """How long and how fast.

    Attributes:
        steps: in all.
        rate: highest learning rate.
        warmup: steps until it is reached; from there it falls as a cosine to a twentieth.
        average: decay of the moving average of the weights.
        clip: largest norm of the gradient.
        precision: float32, or bfloat16 for the network's inner numbers; norms, loss and decoding stay float32.
    """

    steps: int = 300
    rate: float = 1e-3
    warmup: int = 20
    average: float = 0.98
    clip: float = 1.0
    precision: str = "float32"

    def __post_init__(self) -> None:
        if self.steps < 1 or self.rate <= 0 or not 0 <= self.average < 1:
            raise EdreamError(
                f"dream.train has steps {self.steps}, rate {self.rate:g}, average {self.average:g}; expected sane ones."
            )
        if self.precision not in ("float32", "bfloat16"):
            raise EdreamError(f"dream.train.precision is {self.precision!r}; expected float32 or bfloat16.")

    def rate_at(self, step: int) -> float:
        """Learning rate of a step."""
        if step < self.warmup:
            return self.rate * (step + 1) / self.warmup
        done = (step - self.warmup) / max(1, self.steps - self.warmup)
        return self.rate * (0.05 + 0.95 * 0.5 * (1.0 + math.cos(math.pi * min(done, 1.0))))


class Ahead(Generic[T]):
    """What a step is to learn from, made on a thread of its own while the step before is learned.

    It follows from the step's number alone, so when it is made changes nothing.

    Args:
        make: what a step of this number learns from.
        last: the number after the last step's.
    """

    def __init__(self, make: Callable[[int], T], last: int) -> None:
        self._make, self._last = make, last
        self._pool = ThreadPoolExecutor(1)
        self._coming: tuple[int, Future[T]] | None = None

    def __enter__(self) -> "Ahead[T]":
        return self

    def __exit__(self, *_: object) -> None:
        self._pool.shutdown(wait=True, cancel_futures=True)

    def at(self, step: int) -> T:
        """What this step learns from; the next one's is begun."""
        made = self._coming[1] if self._coming and self._coming[0] == step else self._pool.submit(self._make, step)
        self._coming = (step + 1, self._pool.submit(self._make, step + 1)) if step + 1 < self._last else None
        return made.result()


def new_state(network: nn.Module) -> State:
    """The state before the first step."""
    state: State = {}
    for name, tensor in network.state_dict().items():
        value = tensor.detach().cpu().numpy().copy()
        state |= {WEIGHTS + name: value, AVERAGE + name: value.copy()}
    for name, tensor in network.named_parameters():
        state |= {kind + name: np.zeros(tuple(tensor.shape), np.float32) for kind in (FIRST, SECOND)}
    return state


def part(state: Mapping[str, np.ndarray], prefix: str) -> dict[str, Tensor]:
    """The tensors of a state under a prefix, without it."""
    return {name.removeprefix(prefix): torch.from_numpy(np.array(v)) for name, v in state.items() if name.startswith(prefix)}


def train(
    network: nn.Module,
    loss_of: Callable[[int], Tensor],
    state: State,
    first: int,
    last: int,
    schedule: Schedule,
    together: bool = False,
) -> tuple[State, list[float]]:
    """Train from step `first` up to, not including, `last`.

    Whatever is random in a step follows from the step's number alone, so a run that was cut into pieces gives the same bytes.

    Args:
        network: takes the state's weights and is trained in place.
        loss_of: loss of a step.
        state: as `new_state` or the last call gave it.
        together: whether the other processes (`edream.learn.ranks`), if there are any, train the same steps; `loss_of` is to call
            the network through `ranks.as_one` then.

    Returns:
        The new state, and the loss of each step.

    Raises:
        EdreamError: the state does not fit, or the loss is no longer finite.
    """
    fill(network, part(state, WEIGHTS), "The training state")
    device = next(network.parameters()).device
    average = {name: value.to(device) for name, value in part(state, AVERAGE).items()}
    many = device.type == "cuda"  # all tensors at a time there: a GPU waits for hundreds of small calls otherwise
    adam = torch.optim.Adam(network.parameters(), lr=schedule.rate, betas=(0.9, 0.99), foreach=many)
    for name, tensor in network.named_parameters():
        moments = (torch.from_numpy(np.array(state[kind + name])).to(device) for kind in (FIRST, SECOND))
        adam.state[tensor] = dict(zip(("exp_avg", "exp_avg_sq"), moments, strict=True)) | {"step": torch.tensor(float(first))}
    network.train()
    narrow = torch.autocast(device.type, torch.bfloat16) if schedule.precision == "bfloat16" else nullcontext()
    losses = []
    for step in range(first, last):
        for group in adam.param_groups:
            group["lr"] = schedule.rate_at(step)
        adam.zero_grad(set_to_none=True)
        with narrow:
            loss = loss_of(step)
        loss.backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), schedule.clip, foreach=many)
        adam.step()
        losses.append(ranks.mean(loss.detach()) if together else float(loss.detach()))
        if not math.isfinite(losses[-1]):
            raise EdreamError(
                f"The loss is not finite after {step + 1} training steps; lower dream.train.rate ({schedule.rate:g})."
            )
        decay = min(schedule.average, (1.0 + step) / (10.0 + step))
        moving = {name: tensor.float() for name, tensor in network.state_dict().items() if tensor.is_floating_point()}
        get_ema_multi_avg_fn(decay)([average[name] for name in moving], list(moving.values()), step)
    return _state(network, average, adam), losses


def _state(network: nn.Module, average: Mapping[str, Tensor], adam: torch.optim.Adam) -> State:
    state: State = {}
    for name, tensor in network.state_dict().items():
        state[WEIGHTS + name] = tensor.detach().cpu().numpy().copy()
        state[AVERAGE + name] = average[name].cpu().numpy().copy()
    for name, tensor in network.named_parameters():
        state[FIRST + name] = adam.state[tensor]["exp_avg"].cpu().numpy().copy()
        state[SECOND + name] = adam.state[tensor]["exp_avg_sq"].cpu().numpy().copy()
    return state
