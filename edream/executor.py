"""Where shards run: one interface, the same bytes whichever is chosen.

An executor calls `task(job)` for every job, in any order and any process. Tasks keep their own results on disk, so nothing but the
index of a finished job comes back.
"""

import multiprocessing
import os
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from typing import Any

from edream.core.errors import EdreamError, unknown_name


class Executor(ABC):
    """A place to run tasks."""

    @abstractmethod
    def run(self, task: Callable[[Any], None], jobs: Sequence[Any]) -> Iterator[int]:
        """Call `task(job)` for each job; yields the index of each as it is done.

        Args:
            task: a function of a module, or a partial of one.
            jobs: arguments that can be sent to another process.
        """


@dataclass(frozen=True)
class Local(Executor):
    """Processes of this machine.

    Attributes:
        workers: how many; 0 for one a core.
    """

    workers: int = 0

    def run(self, task: Callable[[Any], None], jobs: Sequence[Any]) -> Iterator[int]:
        workers = min(self.workers or cores(), len(jobs))
        if workers <= 1:
            for index, job in enumerate(jobs):
                task(job)
                yield index
            return
        # A fresh interpreter for each: forking a process that runs torch's or MuJoCo's threads can deadlock.
        context = multiprocessing.get_context("spawn")
        pool = ProcessPoolExecutor(workers, mp_context=context, initializer=_end_with_parent)
        try:
            futures = {pool.submit(task, job): index for index, job in enumerate(jobs)}
            for future in as_completed(futures):
                future.result()
                yield futures[future]
        except BrokenProcessPool as error:
            raise EdreamError(
                f"One of {workers} worker processes was killed, most likely for want of memory. Finished shards are kept; "
                f"run the same command again with executor.workers={max(1, workers // 2)}."
            ) from error
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def create(kind: str, workers: int) -> Executor:
    """The executor that the config names.

    Raises:
        EdreamError: there is no such executor, or a negative number of workers.
    """
    if workers < 0:
        raise EdreamError(f"executor.workers is {workers}; expected 0 (one a core) or more.")
    if kind != "local":
        raise unknown_name("executor", kind, ["local"])
    return Local(workers)


def cores() -> int:
    """How many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _end_with_parent() -> None:
    """Let no worker outlive a parent that was killed: it would go on writing shards that nobody waits for."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=lambda: (parent.join(), os._exit(1)), daemon=True).start()
