import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

PROGRAM = Path(__file__).parent / "small_stages.py"
sys.path.insert(0, str(PROGRAM.parent))


@pytest.fixture(scope="session")
def start() -> Callable[..., subprocess.Popen]:
    """Start the small pipeline as a process of its own."""

    def start(runs: Path, workers: int = 1, failpoint: str | None = None, **options) -> subprocess.Popen:
        environment = {**os.environ, "PYTHONPATH": str(PROGRAM.parents[2]), "OMP_NUM_THREADS": "1"}
        if failpoint:
            environment["EDREAM_FAILPOINT"] = failpoint
        command = [sys.executable, str(PROGRAM), str(runs), str(workers)]
        return subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **options)

    return start


@pytest.fixture(scope="session")
def undisturbed(start, tmp_path_factory) -> str:
    """Digest of the final artifact of a run that nothing disturbs."""
    process = start(tmp_path_factory.mktemp("undisturbed"))
    out, errors = process.communicate(timeout=120)
    assert process.returncode == 0, errors
    return out.strip()
