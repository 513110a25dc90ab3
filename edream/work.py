"""What a running stage may use: random numbers, shards that survive a kill, progress, scratch folders."""

import hashlib
import shutil
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np

from edream.core.stage import Artifact, Bundle, Progress, Work
from edream.executor import Executor
from edream.store import MANIFEST, Store, StoredArtifact, publish


class StageWork(Work):
    """The `Work` of one stage under one key.

    Attributes:
        earlier: seconds that shards took which an earlier process finished.
    """

    def __init__(self, store: Store, stage: str, key: str, executor: Executor) -> None:
        self._root = store.work(stage, key)
        self._stage, self._key = stage, key
        self._executor = executor
        self.rng = np.random.default_rng(self._sequence())
        self.earlier = 0.0

    def seed(self, name: str) -> int:
        return int(self._sequence(name).generate_state(1)[0])

    def shards(
        self,
        name: str,
        items: Iterable[Any],
        function: Callable[[Any, np.random.Generator], Bundle],
        parallel: bool | Literal["elsewhere"] = True,
    ) -> Sequence[Artifact]:
        folder = self._root / name
        manifest = {"stage": self._stage, "key": self._key}
        task = partial(_shard, folder=folder, manifest=manifest, sequence=self._sequence(name), function=function)
        if self._executor.elsewhere if parallel == "elsewhere" else parallel:
            jobs = list(enumerate(items))
            count = len(jobs)
            missing = [job for job in jobs if not self._found(folder, job[0])]
            with self.progress(count, f"{self._stage}: {name}") as bar:
                bar.update(count - len(missing))
                for _ in self._executor.run(task, missing):
                    bar.update()
        else:
            count = 0
            total = len(items) if isinstance(items, Sequence) else None
            with self.progress(total, f"{self._stage}: {name}") as bar:
                for index, item in enumerate(items):
                    if not self._found(folder, index):
                        task((index, item))
                    count += 1
                    bar.update()
        return Shards(folder, count)

    @contextmanager
    def progress(self, total: int | None, text: str) -> Iterator[Progress]:
        from tqdm import tqdm

        with tqdm(total=total, desc=text, delay=2.0, leave=False, disable=None, file=sys.stderr) as bar:
            yield bar

    def folder(self, name: str) -> Path:
        folder = self._root / f"{name}.files"
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        return folder

    def _found(self, folder: Path, index: int) -> bool:
        """Whether an earlier process finished a shard; if so, its time counts."""
        place = _place(folder, index)
        if not (place / MANIFEST).exists():
            return False
        self.earlier += StoredArtifact(place).seconds
        return True

    def _sequence(self, name: str = "") -> np.random.SeedSequence:
        words = np.frombuffer(hashlib.sha256(name.encode()).digest()[:8], dtype=np.uint32)
        return np.random.SeedSequence(int(self._key, 16), spawn_key=tuple(int(word) for word in words) if name else ())


class Shards(Sequence[Artifact]):
    """Finished shards, opened when asked for."""

    def __init__(self, folder: Path, count: int) -> None:
        self._folder = folder
        self._count = count

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, index: Any) -> Any:
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(self._count))]
        if not -self._count <= index < self._count:
            raise IndexError(index)
        return StoredArtifact(_place(self._folder, index % self._count))


def _shard(
    job: tuple[int, Any],
    *,
    folder: Path,
    manifest: dict[str, Any],
    sequence: np.random.SeedSequence,
    function: Callable[[Any, np.random.Generator], Bundle],
) -> None:
    index, item = job
    own = np.random.SeedSequence(sequence.entropy, spawn_key=(*sequence.spawn_key, index))
    clock = time.perf_counter()
    bundle = function(item, np.random.default_rng(own))
    publish(_place(folder, index), {**manifest, "made": {"seconds": round(time.perf_counter() - clock, 3)}}, bundle)


def _place(folder: Path, index: int) -> Path:
    return folder / f"{index:06d}"
