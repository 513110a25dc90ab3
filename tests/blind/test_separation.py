"""Diagnosis cannot see the truth: no import leads there, and the process that diagnoses refuses to look."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
BLIND = [
    *sorted((ROOT / "edream").glob("diagnosis/*.py")),
    *sorted((ROOT / "edream").glob("effects/*.py")),
    *sorted((ROOT / "edream").glob("sim/*.py")),
    *sorted((ROOT / "edream").glob("calibration/*.py")),
    *sorted((ROOT / "edream").glob("ingest/*.py")),
    ROOT / "edream" / "stages" / "diagnose.py",
    *(ROOT / "benchmarks" / "blind" / name for name in ("explain.py", "baselines.py", "equation.py", "guard.py")),
]
SEEING = ("edream.reality", "edream.record", "benchmarks.blind.cases", "benchmarks.blind.names", "benchmarks.blind.runner")
TRUTH_WORDS = ("truth.json", "unseal", "truth_path", "sealed truth 1")


def imported(tree: ast.AST) -> list[str]:
    """Full names of what a file imports anywhere."""
    names = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names += [f"{node.module}.{alias.name}" for alias in node.names]
    return names


def sights(source: str) -> list[str]:
    """Imports and texts of a source that lead to the truth."""
    tree = ast.parse(source)
    wrong = [name for name in imported(tree) if name.startswith(SEEING)]
    for node in ast.walk(tree):
        said = node.value if isinstance(node, ast.Constant) else node.id if isinstance(node, ast.Name) else None
        if isinstance(said, str):
            wrong += [word for word in TRUTH_WORDS if word in said]
    return wrong


@pytest.mark.parametrize("path", BLIND, ids=lambda path: str(path.relative_to(ROOT)))
def test_what_diagnoses_neither_imports_the_make_believe_robot_nor_names_a_truth(path: Path) -> None:
    allowed = ["truth.json"] if path.name == "guard.py" else []
    assert [sight for sight in sights(path.read_text()) if sight not in allowed] == []


@pytest.mark.parametrize(
    "source",
    [
        "import edream.reality.truth",
        "from edream.reality import effects",
        "from edream import reality",
        "def f():\n    from edream.record import truth_path",
        "open('recordings.truth.json')",
        "unseal(path)",
    ],
)
def test_a_look_at_the_truth_is_noticed(source: str) -> None:
    if source == "from edream import reality":
        assert imported(ast.parse(source)) == ["edream.reality"]
    assert sights(source)


LOOKS = {
    "import": "import edream.reality.truth",
    "importlib": "import importlib; importlib.import_module('edream.reality')",
    "file": "from pathlib import Path; Path('made/recordings.truth.json').read_text()",
    "folder": "open('blind/truth/0123.json')",
}


@pytest.mark.parametrize("look", LOOKS.values(), ids=LOOKS.keys())
def test_a_blindfolded_process_refuses_to_look(look: str) -> None:
    code = f"from benchmarks.blind.guard import blindfold\nblindfold()\n{look}"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "PeekError: a diagnosis may not" in done.stderr


def test_a_process_that_has_looked_cannot_put_the_blindfold_on() -> None:
    code = "import edream.reality\nfrom benchmarks.blind.guard import blindfold\nblindfold()"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    assert "PeekError: edream.reality was imported before" in done.stderr


def test_the_diagnosing_process_loads_no_torch() -> None:
    code = (
        "import sys, edream.diagnosis.verdict, edream.ingest.recordings, benchmarks.blind.explain, benchmarks.blind.baselines\n"
        "print([name for name in ('torch', 'edream.reality') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
