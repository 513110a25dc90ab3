"""Which artifacts another processor would change: every stage is made again as an older kind would do it, from the same inputs.

    python -m benchmarks.bench_processor

A small pipeline from recordings with video to a calibration, a diagnosis, dreamed video and a policy is made once. Then each of its
artifacts is put aside and made anew by a process whose libraries are told to leave out what older processors do not have, and the
digests are compared. One machine stands in for several: what is compiled in without a choice (MuJoCo's own loops) cannot be
switched off, so "same" here is no proof for another machine, while "differs" is.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from edream import config, pipeline
from edream.store import StoredArtifact

WIDE = "AVX512F,AVX512CD,AVX512VL,AVX512BW,AVX512DQ"
KINDS = {
    "the same again": {},
    "without AVX-512": {
        "ATEN_CPU_CAPABILITY": "avx2",
        "ONEDNN_MAX_CPU_ISA": "AVX2",
        "OPENBLAS_CORETYPE": "Haswell",
        "NPY_DISABLE_CPU_FEATURES": "X86_V4,AVX512_ICL,AVX512_SPR",
        "GLIBC_TUNABLES": "glibc.cpu.hwcaps=" + ",".join(f"-{name}" for name in WIDE.split(",")),
        "OPENCV_CPU_DISABLE": "AVX512-SKX",
        "LP_NATIVE_VECTOR_WIDTH": "256",
    },
    "without AVX2 and FMA": {
        "ATEN_CPU_CAPABILITY": "default",
        "ONEDNN_MAX_CPU_ISA": "SSE41",
        "OPENBLAS_CORETYPE": "Nehalem",
        "NPY_DISABLE_CPU_FEATURES": "X86_V3,X86_V4,AVX512_ICL,AVX512_SPR",
        "GLIBC_TUNABLES": "glibc.cpu.hwcaps=" + ",".join(f"-{name}" for name in f"{WIDE},AVX2,FMA,AVX".split(",")),
        "OPENCV_CPU_DISABLE": "AVX512-SKX,AVX2,FP16,AVX",
        "LP_NATIVE_VECTOR_WIDTH": "128",
    },
}
SMALL = """
  robot=arm6 task=grab_paper_cup seed=1 executor.workers=1 render.height=32 render.width=32 fit.method=surrogate
  fit.seconds=6 fit.stretch=2 fit.search.descent_steps=5 fit.search.polish=2 fit.search.iterations=3
  surrogate.options={hidden:16,epochs:2} sweep.sets=16 sweep.rounds=1 sweep.windows=16 sweep.blocks=8
  diagnose.effects=[stribeck] diagnose.most=1 diagnose.seconds=6 dream.frames=6 dream.train_frames=4 dream.overlap=2
  dream.batch=2 dream.train.steps=6 dream.checkpoint=6 dream.baseline=false dream.ablation=false score.clips=4 score.long=14
  score.steps=[2] policy.height=32 policy.width=32 policy.options.dim=32 policy.options.heads=2 policy.options.encoder=1
  policy.options.feedforward=64 policy.options.widths=[8,16,16] policy.chunk=30 policy.stride=30 sft.train.steps=6
  sft.checkpoint=6 sft.batch=8 sft.held=0.34 sft.twins=true rollouts.eyes=composite rollouts.starts=2 rollouts.samples=2
  rollouts.noise.action=0.5 rollouts.draws=0 rank.margin=0 rl.rounds=1 rl.train.steps=2 rl.checkpoint=2 rl.held=1 rl.batch=2
  evaluate.starts=1 evaluate.films=1 report.of=evaluate
"""
ENDS = ("ingest", "fit", "diagnose", "score", "evaluate")


def words(folder: Path) -> list[str]:
    """All settings."""
    demos = folder / "demos"
    beside = [f"camera.file={demos}.cameras.json", f"render.scene={demos}.scene.json", f"rollouts.plate={demos}.plate.png"]
    return [*SMALL.split(), *beside, f"data={demos}", f"runs={folder}/runs"]


def recorded(out: Path) -> str:
    """Demonstrations of a make-believe robot; their digest."""
    asked = [
        *SMALL.split()[:2],
        f"record.out={out}",
        "record.episodes=5",
        "record.cell.height=32",
        "record.cell.width=32",
        "seed=1",
    ]
    program = [sys.executable, "-c", "from edream.cli import main; main()", "record", *asked, "seed=1", "--json"]
    return str(json.loads(subprocess.run(program, check=True, capture_output=True, text=True).stdout)["digest"])


def artifacts(folder: Path) -> dict[str, StoredArtifact]:
    """What every end is made from, need -> artifact; made where it is not there."""
    cfg = config.compose(words(folder))
    store = pipeline.open_store(cfg)
    found: dict[str, StoredArtifact] = {}
    for end in ENDS:
        found |= pipeline.chain(store, pipeline.make(end, cfg))
    return found


def again(folder: Path, digest: str) -> dict[str, bool]:
    """Whether recordings and artifacts come out the same when each is made anew from the same inputs."""
    place = Path(tempfile.mkdtemp(dir=folder))
    cfg, same = config.compose(words(folder)), {"record": recorded(place / "demos") == digest}
    before = {one.folder for one in pipeline.open_store(cfg).artifacts()}
    found = artifacts(folder)
    if new := [one.stage for one in pipeline.open_store(cfg).artifacts() if one.folder not in before]:
        raise SystemExit(f"{', '.join(new)} was made anew: the processor enters a key")
    for need, one in found.items():
        aside = folder / "aside"
        one.folder.rename(aside)
        made = pipeline.make(need, cfg)
        if made.key != one.key:
            raise SystemExit(f"{need}: the key changed, so the processor enters it")
        same[need] = made.digest == one.digest
        shutil.rmtree(made.folder)
        aside.rename(one.folder)
    return same


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kind", action="append", choices=KINDS)
    parser.add_argument("--again", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--digest", help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.again:
        print("RESULT " + json.dumps(again(asked.again, asked.digest)))
        return
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        digest = recorded(folder / "demos")
        artifacts(folder)
        columns = {}
        for kind, settings in ((kind, KINDS[kind]) for kind in asked.kind or KINDS):
            program = [sys.executable, "-m", "benchmarks.bench_processor", "--again", str(folder), "--digest", digest]
            told = subprocess.run(program, env={**os.environ, **settings}, stdout=subprocess.PIPE, text=True, check=True).stdout
            columns[kind] = json.loads(next(line for line in told.splitlines() if line.startswith("RESULT "))[7:])
            print(kind, columns[kind], flush=True)
    print("\n| artifact | " + " | ".join(columns) + " |\n|" + " --- |" * (1 + len(columns)))
    for need in next(iter(columns.values())):
        print(f"| {need} | " + " | ".join("same" if column[need] else "differs" for column in columns.values()) + " |")


if __name__ == "__main__":
    main()
