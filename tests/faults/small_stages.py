"""Three small stages on the real pipeline, as a program that fault tests kill: grow (shards) -> mix (shards) -> total."""

import os
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet  # here, so that a forked process need not
import safetensors.numpy  # noqa: F401
import tqdm  # noqa: F401
from omegaconf import OmegaConf

from edream import pipeline
from edream.core.errors import EdreamError
from edream.core.stage import Artifact, Bundle, Stage, Work

pa.chunked_array([[1.0]]).to_numpy()  # imports pandas where there is one
SLOW = 0.004  # s of pretended work a shard


@dataclass(frozen=True)
class GrowConfig:
    seed: int
    shards: int


@dataclass(frozen=True)
class MixConfig:
    shards: int
    factor: float


@dataclass(frozen=True)
class TotalConfig:
    pass


def grow_one(item: int, rng: np.random.Generator) -> Bundle:
    time.sleep(SLOW)
    return {"values.safetensors": {"x": rng.normal(size=50) + item}, "about.json": {"item": item}}


def grow(inputs: Mapping[str, Artifact], config: GrowConfig, work: Work) -> Bundle:
    shards = work.shards("values", range(config.shards), grow_one)
    table = pa.table(
        {"x": np.concatenate([shard["values.safetensors"]["x"] for shard in shards]), "z": work.rng.normal(size=50 * len(shards))}
    )
    return {"values.parquet": table}


def mix(inputs: Mapping[str, Artifact], config: MixConfig, work: Work) -> Bundle:
    x = inputs["grow"]["values.parquet"]["x"].to_numpy()

    def one(part: np.ndarray, rng: np.random.Generator) -> Bundle:
        time.sleep(SLOW)
        path = work.folder("big") / "part.bin"
        path.write_bytes((config.factor * part + rng.normal(size=part.shape)).tobytes())
        return {"part.bin": path}

    shards = work.shards("parts", np.array_split(x, config.shards), one, parallel=False)
    return {f"parts/{i}.bin": shard.path("part.bin") for i, shard in enumerate(shards)} | {"note.txt": "mixed\n"}


def total(inputs: Mapping[str, Artifact], config: TotalConfig, work: Work) -> Bundle:
    mixed = inputs["mix"]
    values = np.concatenate([np.frombuffer(mixed[name]) for name in sorted(mixed) if name.endswith(".bin")])
    return {"summary.json": {"total": float(values.sum()), "seed": work.seed("total")}}


def fails(job: int) -> None:
    """A task that cannot do its third job."""
    if job == 2:
        raise EdreamError("Job 2 cannot be done.")


STAGES = {
    "grow": Stage("grow", 1, (), GrowConfig, grow, numerics=("numpy",)),
    "mix": Stage("mix", 1, ("grow",), MixConfig, mix),
    "total": Stage("total", 1, ("mix",), TotalConfig, total),
}


def settings(runs: Path, workers: int = 1, shards: int = 8, factor: float = 2.0, seed: int = 0, run: str | None = None):
    values = {"runs": str(runs), "run": run, "executor": {"kind": "local", "workers": workers}}
    return OmegaConf.create(values | {"shards": shards, "factor": factor, "seed": seed})


def install() -> None:
    """Let the pipeline find these stages beside its own."""
    own = pipeline.stage
    pipeline.stage = lambda name: STAGES[name] if name in STAGES else own(name)


def turn_clock(days: float) -> None:
    """Let the pipeline's clock be off by so many days, and jump by as many more whenever it is read."""
    jumps = iter(range(1, 10**9))

    class Jumping(datetime):
        @classmethod
        def now(cls, tz=None):
            return datetime.now(tz) + next(jumps) * timedelta(days=days)

    pipeline.datetime = Jumping  # type: ignore[misc]


def once(runs: str, failpoint: str | None, out: str, slow: float = 0.0) -> None:
    """Make everything in this process, killed at a point where one is given; the final digest is written into `out`."""
    global SLOW
    SLOW = slow
    if failpoint:
        os.environ["EDREAM_FAILPOINT"] = failpoint
    install()
    made, _ = pipeline.make_run("total", ("total",), settings(Path(runs), run="test"))
    Path(out).write_text(made["total"].digest)


if __name__ == "__main__":
    install()
    turn_clock(float(os.environ.get("EDREAM_TEST_CLOCK", "0")))
    made, _ = pipeline.make_run("total", ("total",), settings(Path(sys.argv[1]), workers=int(sys.argv[2]), run="test"))
    print(made["total"].digest)
