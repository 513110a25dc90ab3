"""One thread count and deterministic algorithms: what makes torch's bytes repeat."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import torch

from edream.core.cores import cores

MEMORY: Any = torch.utils.deterministic  # a module whose attributes are made when they are asked for


def threads() -> int:
    """The thread count that keys record: OMP_NUM_THREADS, or every core this process may use."""
    asked = os.environ.get("OMP_NUM_THREADS", "")
    return int(asked) if asked.isdigit() and int(asked) > 0 else cores()


@contextmanager
def deterministic(count: int | None = None) -> Iterator[None]:
    """Pin the thread count (`threads()` where None) and forbid algorithms that differ from run to run; both are put back after.

    torch would also fill memory before it is written, which slows a GPU by up to a third and matters only to code that reads what
    nobody wrote.
    """
    before, strict = torch.get_num_threads(), torch.are_deterministic_algorithms_enabled()
    filled = MEMORY.fill_uninitialized_memory
    torch.set_num_threads(count or threads())
    torch.use_deterministic_algorithms(True)
    MEMORY.fill_uninitialized_memory = False
    try:
        yield
    finally:
        torch.set_num_threads(before)
        torch.use_deterministic_algorithms(strict)
        MEMORY.fill_uninitialized_memory = filled
