"""Where shards run: one interface, the same bytes whichever is chosen.

An executor calls `task(job)` for every job, in any order and any process. Tasks keep their own results on disk, so nothing but the
index of a finished job comes back.
"""

import logging
import multiprocessing
import os
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from itertools import islice
from typing import Any, ClassVar

from edream.core.cores import cores
from edream.core.errors import EdreamError, unknown_name


class Executor(ABC):
    """A place to run tasks.

    Attributes:
        elsewhere: whether it reaches beyond this machine.
    """

    elsewhere: ClassVar[bool] = False

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


@dataclass(frozen=True)
class Ray(Executor):
    """Tasks on a Ray cluster, whose machines all see the store's folder under the same path.

    A task whose machine or process dies is begun again elsewhere; what it published before it died is found, not made twice.

    Attributes:
        address: of the cluster; "auto" for the one that `ray start` began here, None for a new one on this machine alone.
        workers: at most so many tasks at once; 0 for one a core of the cluster.
        retries: how often a task is begun again where a machine or process died under it.
    """

    elsewhere: ClassVar[bool] = True
    address: str | None = None
    workers: int = 0
    retries: int = 5

    def run(self, task: Callable[[Any], None], jobs: Sequence[Any]) -> Iterator[int]:
        if not jobs:
            return
        ray = self._joined()
        threads = os.environ.get("OMP_NUM_THREADS") or str(cores())  # as in processes of this machine: it changes sums
        passed = {name: os.environ[name] for name in ("MUJOCO_GL", "PYOPENGL_PLATFORM", "PYTHONPATH") if name in os.environ}
        options = {"num_cpus": 1, "max_retries": self.retries, "runtime_env": {"env_vars": {**passed, "OMP_NUM_THREADS": threads}}}
        remote, shared = ray.remote(_called).options(**options), ray.put(task)
        most = self.workers or 2 * max(1, int(ray.cluster_resources().get("CPU", 1)))
        waiting: dict[Any, int] = {}
        todo = iter(enumerate(jobs))
        try:
            while True:
                for index, job in islice(todo, most - len(waiting)):  # a million jobs are not handed over at once
                    waiting[remote.remote(shared, job)] = index
                if not waiting:
                    return
                done, _ = ray.wait(list(waiting), num_returns=1)
                ray.get(done[0])
                yield waiting.pop(done[0])
        except ray.exceptions.RayTaskError as error:
            raise (error.cause if isinstance(error.cause, EdreamError) else error) from None
        except (ray.exceptions.WorkerCrashedError, ray.exceptions.NodeDiedError, ray.exceptions.OutOfMemoryError) as error:
            raise EdreamError(
                f"A machine or process of the Ray cluster died {self.retries + 1} times under one task "
                f"({type(error).__name__}), most likely for want of memory. Finished shards are kept; run the same command again."
            ) from error
        finally:
            for left in waiting:
                ray.cancel(left, force=True)

    def _joined(self) -> Any:
        try:
            import ray  # pyright: ignore[reportMissingImports]
        except ImportError as error:
            raise EdreamError("executor=ray needs Ray, which is not installed; pip install 'edream[ray]'.") from error
        if not ray.is_initialized():
            try:
                ray.init(address=self.address, log_to_driver=False, logging_level=logging.ERROR)
            except ConnectionError as error:
                raise EdreamError(
                    f"There is no Ray cluster at executor.address={self.address}; begin one with 'ray start --head', or give "
                    "executor.address=null for one on this machine alone."
                ) from error
        return ray


def _called(task: Callable[[Any], None], job: Any) -> None:
    task(job)


def create(kind: str, workers: int, address: str | None = None) -> Executor:
    """The executor that the config names.

    Raises:
        EdreamError: there is no such executor, or a negative number of workers.
    """
    if workers < 0:
        raise EdreamError(f"executor.workers is {workers}; expected 0 (one a core) or more.")
    if kind not in ("local", "ray"):
        raise unknown_name("executor", kind, ["local", "ray"])
    return Local(workers) if kind == "local" else Ray(address, workers)


def _end_with_parent() -> None:
    """Let no worker outlive a parent that was killed: it would go on writing shards that nobody waits for."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=lambda: (parent.join(), os._exit(1)), daemon=True).start()
