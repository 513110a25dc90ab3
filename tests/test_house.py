"""The house rules: who may import whom, how long a file may be, and what is never written."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = ROOT / "edream"
PLUMBING = {"catalog", "config", "store", "kinds", "executor", "work"}
ENTRIES = {"effects", "formats", "fitters", "surrogates", "codecs", "denoisers", "objectives", "segmenters", "metrics"} | {
    *("policies", "preferences", "tasks"),
}
METHODS = {"ingest", "calibration", "diagnosis", "vision", "practice"}  # what the stages of one job share
SIDES = {"sim", "learn"}
MAY_IMPORT = {
    "core": {"core"},
    "catalog": {"core"},
    "kinds": {"core"},
    "config": {"core"},
    "executor": {"core"},
    "store": {"core", "kinds"},
    "work": {"core", "store", "executor"},
    "sim": {"core", "sim"},
    "learn": {"core", "learn"},
    "reality": {"core", "sim.robot", "reality", "robots"},
    "export": {"core", "catalog", "ingest"},
    "gym": {"core", "catalog", "sim", "vision", "reality"},
    "record": {"core", "catalog", "sim", "reality"},
    "record_task": {"core", "catalog", "executor", "sim", "reality", "record"},
    "pipeline": {"core", "stages"} | PLUMBING,
    "report": {"core", "sim", "learn", "report", "catalog"} | METHODS,
}
CORE_PACKAGES = {"numpy", "jaxtyping"}
REALITY_READERS = ("record", "stages.record", "stages.evaluate", "gym")
MUJOCO_FREE = {"core", "learn"} | PLUMBING
MOST_LINES = 400
PLUMBING_LINES = 1200
FORBIDDEN_CALLS = {"eval", "exec", "compile", "__import__"}
FORBIDDEN_MODULES = {"pickle", "dill", "cloudpickle", "joblib", "shelve", "marshal"}

FILES = sorted(path for path in PACKAGE.rglob("*.py"))


def module_of(path: Path) -> str:
    """Dotted name inside the package: "sim.robot", "cli", "" for the package itself."""
    parts = path.relative_to(PACKAGE).with_suffix("").parts
    return ".".join(part for part in parts if part != "__init__")


def imports(path: Path) -> Iterator[str]:
    """Full names that a file imports when it runs, those inside functions too."""
    tree = ast.parse(path.read_text())
    for_checkers = {
        inner
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"
        for inner in ast.walk(node)
    }
    for node in ast.walk(tree):
        if node in for_checkers:
            continue
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import; write it in full"
            for alias in node.names:
                whole = f"{node.module}.{alias.name}"
                is_module = (ROOT / Path(*whole.split("."))).is_dir() or (ROOT / Path(*whole.split("."))).with_suffix(
                    ".py"
                ).is_file()
                yield whole if is_module else str(node.module)


def allowed(module: str, target: str) -> bool:
    """Whether the arrow from `module` to `target` (both inside the package) points right."""
    home, to = module.partition(".")[0], target.partition(".")[0]
    if to in ("", "robots"):
        return True
    if to == "reality" and home != "reality":
        return module.startswith(REALITY_READERS)
    if to in ENTRIES and home not in ENTRIES:
        return False
    if home.startswith("cli"):
        return to in {"core", "pipeline", "record", "record_task", "export"} | METHODS | PLUMBING or to.startswith("cli")
    if home in ENTRIES:
        return to in {"core", "sim", "learn"} | METHODS or target == module
    if home == "stages":
        return to in {"core", "sim", "learn", "report", "catalog", "reality"} | METHODS or target == module
    if home in METHODS:
        return to in {"core", "catalog", "sim", "learn", home} | ({"vision", "calibration"} if home == "practice" else set())
    right = MAY_IMPORT[home]
    return to in right or target in right


@pytest.mark.parametrize("path", FILES, ids=lambda path: module_of(path) or "edream")
def test_every_import_points_right(path: Path) -> None:
    module = module_of(path)
    inside = [name.removeprefix("edream").removeprefix(".") for name in imports(path) if name.split(".")[0] == "edream"]
    wrong = [target for target in inside if module and not allowed(module, target)]
    assert not wrong, f"{path.relative_to(ROOT)} may not import {', '.join(wrong)}"


@pytest.mark.parametrize(
    ("module", "target"),
    [
        ("core.episode", "sim.robot"),
        ("sim.rollout", "learn.train"),
        ("effects.coulomb", "effects.viscous"),
        ("effects.coulomb", "reality.effects"),
        ("stages.diagnose", "reality.truth"),
        ("diagnosis.score", "reality.plant"),
        ("stages.fit", "stages.sweep"),
        ("store", "sim.robot"),
        ("sim.rollout", "effects.coulomb"),
        ("reality.plant", "sim.rollout"),
    ],
)
def test_a_wrong_arrow_is_noticed(module: str, target: str) -> None:
    assert not allowed(module, target)


def test_core_needs_nothing_but_numpy() -> None:
    import sys

    for path in (PACKAGE / "core").rglob("*.py"):
        outside = {name.split(".")[0] for name in imports(path)} - {"edream"} - set(sys.stdlib_module_names)
        assert outside <= CORE_PACKAGES, f"{path.relative_to(ROOT)} imports {outside - CORE_PACKAGES}"


def test_only_the_simulating_parts_import_mujoco() -> None:
    for path in FILES:
        if module_of(path).partition(".")[0] in MUJOCO_FREE:
            assert "mujoco" not in {name.split(".")[0] for name in imports(path)}, path


@pytest.mark.parametrize("path", FILES, ids=lambda path: module_of(path) or "edream")
def test_no_pickle_no_eval_and_no_blind_loading(path: Path) -> None:
    assert not {name.split(".")[0] for name in imports(path)} & FORBIDDEN_MODULES, path
    for node in ast.walk(ast.parse(path.read_text())):
        if not isinstance(node, ast.Call):
            continue
        if isinstance(node.func, ast.Name):
            assert node.func.id not in FORBIDDEN_CALLS, f"{path}:{node.lineno} calls {node.func.id}"
        if (
            isinstance(node.func, ast.Attribute)
            and node.func.attr == "load"
            and ast.unparse(node.func.value) in ("np", "numpy", "torch")
        ):
            keywords = {keyword.arg: ast.unparse(keyword.value) for keyword in node.keywords}
            safe = keywords.get("weights_only") == "True" or keywords.get("allow_pickle") == "False"
            assert safe, f"{path}:{node.lineno} loads without weights_only=True or allow_pickle=False"


def test_no_exception_is_caught_and_dropped() -> None:
    for path in FILES:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ExceptHandler):
                assert node.type is not None, f"{path}:{node.lineno}: bare except"
                assert not (len(node.body) == 1 and isinstance(node.body[0], ast.Pass)), f"{path}:{node.lineno}: caught and dropped"


def test_no_file_is_longer_than_a_reader_can_hold() -> None:
    paths = [path for folder in ("edream", "tests", "benchmarks") for path in (ROOT / folder).rglob("*.py")]
    long = [f"{path.relative_to(ROOT)}: {lines}" for path in paths if (lines := len(path.read_text().splitlines())) > MOST_LINES]
    assert not long


def test_plumbing_stays_small() -> None:
    total = sum(len((PACKAGE / f"{name}.py").read_text().splitlines()) for name in PLUMBING)
    assert total < PLUMBING_LINES, total


def test_only_one_name_for_each_concept() -> None:
    vague = {"utils", "util", "helpers", "helper", "manager", "common", "misc"}
    assert not [path for path in FILES if vague & set(path.with_suffix("").parts[len(PACKAGE.parts) :])]
