"""Several processes that train one network together, as torchrun starts them: who they are, what they say, one gradient for all.

The first process leads: it alone makes artifacts, and tells the others which piece of a training comes next. So a training that was
killed goes on at its last piece, however many processes there were.
"""

import importlib
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import timedelta
from typing import Any

import numpy as np
import torch
import torch.distributed as dist
from torch import Tensor, nn

from edream.core.errors import EdreamError

LONG = timedelta(days=7)  # the others wait while the first one ingests, calibrates, renders
STOP = -1
Order = tuple[int, int, int]
"""Number of what is trained, first and last step."""


def rank() -> int:
    """This process' number, 0 for the one that leads and for one that is alone."""
    return dist.get_rank() if _joined() else 0


def world() -> int:
    """How many processes train together."""
    return dist.get_world_size() if _joined() else 1


@contextmanager
def joined() -> Iterator[int]:
    """Join the other processes that torchrun started, as their number.

    Raises:
        EdreamError: torchrun started more processes than there are GPUs.
    """
    if torch.cuda.is_available():
        own, there = int(os.environ["LOCAL_RANK"]), torch.cuda.device_count()
        if own >= there:
            raise EdreamError(f"torchrun started process {own + 1} on a machine with {there} GPUs; give --nproc-per-node={there}.")
        torch.cuda.set_device(own)
    meet("cpu:gloo,cuda:nccl" if torch.cuda.is_available() else "gloo", timeout=LONG)
    try:
        yield dist.get_rank()
        if dist.get_rank() == 0:
            _say((STOP, 0, 0))
    except EdreamError:  # told by `main`; the others wait for an order, or met the same mistake and are gone
        if dist.get_rank() == 0:
            with suppress(RuntimeError):
                _say((STOP, 0, 0))
        raise
    finally:
        dist.destroy_process_group()


def meet(backend: str, **how: Any) -> None:
    """Begin a group of processes, as `init_process_group` does.

    torch imports a part of itself with the first optimiser only. Imported while a group is there, that part keeps the group's
    threads alive behind `destroy_process_group`, and a process that ends with them is aborted now and then: it is imported before.
    """
    importlib.import_module("torch._dynamo")
    dist.init_process_group(backend, **how)


def lead(order: Order, state: dict[str, np.ndarray]) -> None:
    """Tell the others which piece comes next and what it begins with; nothing where this process is alone."""
    if _joined():
        _say(order)
        _spread(state)


def led(order: Order, state: dict[str, np.ndarray]) -> bool:
    """Ask the others to train a piece along, and tell them what it begins with; False where one of them has not this number, or
    there are none: this process trains it alone."""
    if not _joined():
        return False
    _say(order)
    if not _agreed(True):
        return False
    _spread(state)
    return True


def orders(own: int | None = None) -> Iterator[Order]:
    """What the first process says, until it is done.

    Args:
        own: the only number that this process trains along, where the first one asks (`led`).
    """
    while True:
        told = torch.zeros(3, dtype=torch.int64)
        dist.broadcast(told, 0)
        if int(told[0]) == STOP:
            return
        if own is None or _agreed(int(told[0]) == own):
            yield int(told[0]), int(told[1]), int(told[2])


def followed(state: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The state of the first process; `state` has its names and shapes."""
    return _spread({name: value.copy() for name, value in state.items()})


def as_one(network: nn.Module) -> nn.Module:
    """The network as it is called in training: with gradients averaged over all processes, or itself where this one is alone."""
    return nn.parallel.DistributedDataParallel(network) if _joined() else network


def mean(value: Tensor) -> float:
    """A number's mean over all processes."""
    if not _joined():
        return float(value)
    total = value.detach().clone()
    dist.all_reduce(total)
    return float(total) / dist.get_world_size()


def _joined() -> bool:
    return dist.is_available() and dist.is_initialized()


def _agreed(own: bool) -> bool:
    votes = torch.tensor(int(own))
    dist.all_reduce(votes, dist.ReduceOp.MIN)
    return bool(votes)


def _say(order: Order) -> None:
    dist.broadcast(torch.tensor(order, dtype=torch.int64), 0)


def _spread(state: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    for name in sorted(state):
        state[name] = np.array(state[name])  # contiguous and writable
        dist.broadcast(torch.from_numpy(state[name]), 0)
    return state
