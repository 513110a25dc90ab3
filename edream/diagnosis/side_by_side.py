"""Independent searches on as many cores as there are: a simulation with a hook runs on one of them alone."""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from edream.core.cores import cores

A = TypeVar("A")
B = TypeVar("B")
MOST = 8  # threads: more of them wait for each other in Python


def side_by_side(work: Callable[[A], B], items: Sequence[A], threads: int = 0) -> Iterator[B]:
    """What `work` makes of each item, in their order, on threads: MuJoCo steps without holding Python up.

    Args:
        work: shares nothing that it changes with another call, so that the results do not depend on the number of threads.
        items: what it is called with.
        threads: at most so many at a time; 0 for every core.
    """
    count = min(threads or cores(), len(items), MOST)
    if count < 2:
        yield from map(work, items)
        return
    pool = ThreadPoolExecutor(count)
    try:
        yield from pool.map(work, items)
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
