"""A stage: one step from recordings to results, and what it may see while it runs."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Protocol

import numpy as np

Bundle = Mapping[str, Any]
"""What a stage or a shard makes: file name -> value, by the name's suffix (see `edream.kinds`).

`.parquet` a pyarrow.Table; `.json` anything JSON can say; `.safetensors` a mapping of arrays; `.xml .py .csv .html .txt .md` text;
other suffixes bytes. A `Path` under any name takes that file as it is.
"""

Source = Path | bytes
"""Something from outside the store, whose content enters the key: a file, a folder, or bytes."""


class Artifact(ABC, Mapping[str, Any]):
    """What a stage made: file name -> value, each read and checked against its digest when it is asked for.

    Attributes:
        stage: name of the stage that made it.
        key: hash of all that it was made from.
        digest: hash of what it says, independent of how that lies on disk.
        seconds: how long making it took, without what it was made from; for reading, and part of no hash.
    """

    stage: str
    key: str
    digest: str
    seconds: float

    @abstractmethod
    def path(self, name: str) -> Path:
        """Where a file lies, once its bytes were checked; for files too big to hold, such as episodes.

        Raises:
            EdreamError: there is no such file, or it is not what was written.
        """


class Progress(Protocol):
    """A progress bar; silent where nobody watches."""

    def update(self, n: int = 1) -> object:
        """`n` more steps are done."""
        ...


class Work(ABC):
    """What a running stage may use besides its inputs and its config.

    Attributes:
        rng: random numbers of this stage, seeded from its key.
    """

    rng: np.random.Generator

    @abstractmethod
    def seed(self, name: str) -> int:
        """A number below 2^32 that depends on the key and `name` alone; for libraries with generators of their own."""

    @abstractmethod
    def shards(
        self,
        name: str,
        items: Iterable[Any],
        function: Callable[[Any, np.random.Generator], Bundle],
        parallel: bool | Literal["elsewhere"] = True,
    ) -> Sequence[Artifact]:
        """`function(item, rng)` for each item, each result kept on disk as soon as it is there.

        A run that was killed finds its finished shards again and goes on with the others. The generator of each shard depends on
        the key, `name` and the item's place alone, so neither order nor the number of processes changes a number.

        Args:
            name: unique within the stage.
            items: what to work on; may be a generator where `parallel` is False.
            function: a function of a module (a closure where `parallel` is not True), so that other processes find it.
            parallel: use the processes of the executor; False runs one after the other in this process. "elsewhere" uses other
                machines where the executor has some, and this process alone where not: for work that takes all cores by itself.

        Returns:
            The shards in the order of the items, read when asked for.
        """

    @abstractmethod
    def progress(self, total: int | None, text: str) -> AbstractContextManager[Progress]:
        """A progress bar that appears after two seconds on a terminal and never elsewhere."""

    @abstractmethod
    def folder(self, name: str) -> Path:
        """A new, empty folder for files that are too big to hold; put their paths in the bundle to keep them."""


def stage_of(need: str) -> str:
    """The stage of a need: `fit`, and `fit fit.method=cmaes`, which is the same stage under other settings, are both of `fit`."""
    return need.partition(" ")[0]


@dataclass(frozen=True)
class Stage:
    """One step of the pipeline: a file in `edream/stages/` whose `ENTRY` is one of these.

    Attributes:
        name: the file's name.
        version: raise it when the meaning of the output changes.
        needs: stages whose artifacts it reads, or how they follow from its config. `fit fit.method=cmaes` is the artifact that
            `fit` makes where that setting differs.
        config: a frozen dataclass that lists exactly what it reads from the config. `Path` fields never enter the key themselves;
            what they lead to does.
        run: `run(inputs, config, work)` makes the artifact. `inputs` maps each need to its artifact.
        sources: outside data whose content enters the key, by name; None for the file or folder of every `Path` field.
        numerics: packages whose version changes the numbers, such as ("mujoco",). With "torch" the counts of threads and of
            processes that train together enter too.
        follow: `follow(inputs, config, folder)` helps another process that runs this stage, until that one is done; None where one
            process does it alone. Nothing that it leaves in `folder` is kept.
    """

    name: str
    version: int
    needs: tuple[str, ...] | Callable[[Any], tuple[str, ...]]
    config: type
    run: Callable[[Mapping[str, Artifact], Any, Work], Bundle]
    sources: Callable[[Any], Mapping[str, Source]] | None = None
    numerics: tuple[str, ...] = ()
    follow: Callable[[Mapping[str, Artifact], Any, Path], None] | None = None

    def needs_for(self, config: Any) -> tuple[str, ...]:
        """The stages it reads under this config."""
        return self.needs(config) if callable(self.needs) else self.needs
