"""Memory and time of ingest and sweep with the number of episodes: each in a process of its own, its peak taken from the kernel.

    python benchmarks/bench_scale.py --episodes 10 --episodes 100 --episodes 1000

Episodes are those of a recorded make-believe head, as many times as asked, under other names and with other noise, so that no two
are the same.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import h5py
import numpy as np

ROOT = Path(__file__).resolve().parent.parent
STAGE = "import sys; from edream import config, pipeline; pipeline.make(sys.argv[1], config.compose(sys.argv[2:]))"
SETTINGS = ["robot=pan_tilt", "fit.method=surrogate", "sweep.sets=16", "sweep.rounds=1", "seed=1"]


def multiplied(source: Path, folder: Path, count: int) -> Path:
    """`count` ALOHA episodes from a few recorded ones."""
    folder.mkdir()
    files = sorted(source.glob("*.hdf5"))
    for number in range(count):
        rng = np.random.default_rng(number)
        with h5py.File(files[number % len(files)]) as old, h5py.File(folder / f"episode_{number}.hdf5", "w") as new:
            for name, value in old.attrs.items():
                new.attrs[name] = value
            old.visititems(lambda name, item, new=new, rng=rng: _copy(new, name, item, rng))
    return folder


def _copy(new: h5py.File, name: str, item: object, rng: np.random.Generator) -> None:
    if isinstance(item, h5py.Dataset):
        noise = 1e-5 * rng.standard_normal(item.shape) if item.dtype.kind == "f" else 0
        new.create_dataset(name, data=item[()] + noise if item.dtype.kind == "f" else item[()])


def measured(stage: str, words: list[str]) -> dict[str, float]:
    """Peak memory [MB], clock and processor [s] of making one stage, in a process of its own."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    clock = time.perf_counter()
    process = subprocess.Popen([sys.executable, "-c", STAGE, stage, *words], env=environment)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SystemExit(f"{stage} ended with {process.returncode}")
    megabytes = usage.ru_maxrss / (1024.0 if sys.platform != "darwin" else 1024.0**2)
    return {
        "peak_mb": round(megabytes, 1),
        "seconds": round(time.perf_counter() - clock, 1),
        "cpu_s": round(usage.ru_utime + usage.ru_stime, 1),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--episodes", type=int, action="append")
    parser.add_argument("--seconds", type=float, default=4.0, help="length of an episode")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        record = ["record", "robot=pan_tilt", f"record.out={folder}/few", "record.motions=5", f"record.seconds={asked.seconds}"]
        program = [sys.executable, "-c", "from edream.cli import main; main()", *record, "seed=1", "--json"]
        subprocess.run(program, check=True, stdout=subprocess.DEVNULL, env={**os.environ, "PYTHONPATH": str(ROOT)})
        rows = []
        for count in asked.episodes or [10, 100, 1000]:
            data = multiplied(folder / "few", folder / f"many{count}", count)
            words = [*SETTINGS, f"data={data}", f"runs={folder}/runs{count}"]
            for stage in ("ingest", "sweep"):
                rows.append({"episodes": count, "stage": stage, **measured(stage, words)})
                print(json.dumps(rows[-1]), flush=True)
    print("\n| stage | " + " | ".join(f"{count} episodes" for count in dict.fromkeys(row["episodes"] for row in rows)) + " |")
    for stage in ("ingest", "sweep"):
        cells = [f"{row['peak_mb']} MB, {row['cpu_s']} s" for row in rows if row["stage"] == stage]
        print(f"| {stage}: peak memory, processor | " + " | ".join(cells) + " |")
    print(f"this process: {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MB")


if __name__ == "__main__":
    main()
