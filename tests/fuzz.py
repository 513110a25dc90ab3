"""Breaks recordings of every format, and other files that users give, for as long as asked; memory and time are bounded.

    python -m tests.fuzz --minutes 1 --format lerobot_v3 --seed 7

Whatever comes of a broken file must be a recording, a `Malformed` or an `EdreamError`. Anything else is printed with its seed,
which makes the same broken file again (`--only SEED`), and ends in exit code 1.
"""

import argparse
import multiprocessing
import resource
import shutil
import signal
import tempfile
import time
import traceback
from pathlib import Path

import numpy as np

from edream import catalog
from edream.core.errors import EdreamError
from edream.core.format import Format
from tests.fuzz_files import FILES, make_files, read_files
from tests.recordings import make_sample
from tests.unit.test_fuzz_formats import read_all

MEMORY = 6 << 30  # bytes of address space; numpy, pyarrow and codecs alone map more than one gigabyte
PATIENCE = 60  # s of one broken file
INTERESTING = (0, 1, 0x7F, 0x80, 0xFF, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0xFFFFFFFF, 2**63 - 1, 2**64 - 1)
WORDS = (b"NaN", b"Infinity", b"-1", b"1e999", b"null", b"../../etc/passwd", b"{}", b"[]", b'"', b"\x00", b"999999999999")


def broken(data: bytes, other: bytes, rng: np.random.Generator) -> bytes:
    """A file with one to four things done to it."""
    for _ in range(int(rng.integers(1, 5))):
        at = int(rng.integers(0, max(1, len(data))))
        size = int(rng.integers(1, 65))
        match int(rng.integers(0, 8)):
            case 0:
                data = data[:at]
            case 1:
                data = data[:at] + bytes([int(rng.integers(0, 256))]) + data[at + 1 :]
            case 2:
                data = data[:at] + data[at + size :]
            case 3:
                data = data[:at] + data[at : at + size] * int(rng.integers(2, 50)) + data[at + size :]
            case 4:
                place = int(rng.integers(0, max(1, len(other))))
                data = data[:at] + other[place : place + size] + data[at + size :]
            case 5:
                number = INTERESTING[int(rng.integers(len(INTERESTING)))]
                width = int(rng.choice([1, 2, 4, 8]))
                raw = (number & ((1 << 8 * width) - 1)).to_bytes(width, "little" if rng.random() < 0.7 else "big")
                data = data[:at] + raw + data[at + width :]
            case 6:
                word = WORDS[int(rng.integers(len(WORDS)))]
                data = data[:at] + word + data[at + len(word) :]
            case _:
                data = data[:at] + rng.bytes(size) + data[at:]
    return data


def one(name: str, sample: Path, seed: int) -> None:
    """Break a copy of the sample as the seed says, and read it."""
    rng = np.random.default_rng(seed)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(shutil.copytree(sample, Path(folder) / "set"))
        files = sorted(file for file in path.rglob("*") if file.is_file())
        for victim in rng.choice(files, size=min(len(files), int(rng.integers(1, 3))), replace=False):
            other = files[int(rng.integers(len(files)))].read_bytes()
            Path(victim).write_bytes(broken(Path(victim).read_bytes(), other, rng))
        if name in FILES:
            assert all(said and "\n" not in said for said in read_files(name, path)), "one sentence must say something"
            return
        try:
            read_all(catalog.load("formats", name, Format), path)
        except EdreamError as error:
            assert str(error), "a sentence must say something"


def _sample(name: str, folder: Path) -> Path:
    return make_files(name, folder) if name in FILES else make_sample(name, folder)


def child(name: str, sample: str, first: int, seconds: float, out: str) -> None:
    """Read broken files until the time is over; write down each seed before it is tried."""
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    seed, until = first, time.monotonic() + seconds
    with Path(out).open("w", buffering=1) as log:
        while time.monotonic() < until:
            log.write(f"{seed}\n")
            signal.alarm(PATIENCE)
            try:
                one(name, Path(sample), seed)
            except Exception:  # noqa: BLE001 - whatever it is, it is what is sought
                log.write(f"FAILED {seed}\n{traceback.format_exc()}\n")
                return
            signal.alarm(0)
            seed += 1
        log.write("done\n")


def fuzz(name: str, minutes: float, seed: int) -> tuple[int, list[str]]:
    """How many broken files of a format were read, and what went wrong."""
    context = multiprocessing.get_context("spawn")
    left, tried, wrong, done = 60.0 * minutes, 0, [], False
    with tempfile.TemporaryDirectory() as folder:
        sample = _sample(name, Path(folder))
        while left > 0 and not done and len(wrong) < 10:
            log, clock = Path(folder) / "log", time.monotonic()
            log.unlink(missing_ok=True)
            process = context.Process(target=child, args=(name, str(sample), seed, left, str(log)))
            process.start()
            process.join()
            lines = log.read_text().splitlines() if log.exists() else []
            seeds = [line for line in lines if line.isdigit()]
            tried, done, last = tried + len(seeds), lines[-1:] == ["done"], seeds[-1] if seeds else str(seed)
            if not done:
                failed = "\n".join(lines[lines.index(f"FAILED {last}") :]) if f"FAILED {last}" in lines else ""
                wrong.append(f"{name}, seed {last}, exit code {process.exitcode}\n{failed}")
            seed, left = int(last) + 1, left - (time.monotonic() - clock)
    return tried, wrong


def main() -> None:
    names = [*catalog.names("formats"), *FILES]
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=1.0, help="for each format")
    parser.add_argument("--format", action="append", choices=names, dest="formats")
    parser.add_argument("--seed", type=int, default=0, help="of the first broken file")
    parser.add_argument("--only", type=int, help="read this one broken file here and now")
    asked = parser.parse_args()
    found = []
    for name in asked.formats or names:
        if asked.only is not None:
            with tempfile.TemporaryDirectory() as folder:
                one(name, _sample(name, Path(folder)), asked.only)
            continue
        tried, wrong = fuzz(name, asked.minutes, asked.seed)
        print(f"{name}: {tried} broken data sets in {asked.minutes:g} min, {len(wrong)} crashes", flush=True)
        found += wrong
    print("\n\n".join(found))
    raise SystemExit(1 if found else 0)


if __name__ == "__main__":
    main()
