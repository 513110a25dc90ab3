"""The order of stages: what a stage needs is made first, and nothing is made twice."""

import hashlib
import os
import platform
import re
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from omegaconf import DictConfig, OmegaConf

from edream import __version__, catalog, config, executor, kinds
from edream.core.cores import cores
from edream.core.errors import EdreamError
from edream.core.stage import Source, Stage, stage_of
from edream.store import Store, StoredArtifact, writing
from edream.work import StageWork

PACKAGES = ("numpy", "mujoco", "torch", "pyarrow", "scipy", "mcap", "safetensors")


@dataclass(frozen=True)
class Plumbing:
    """What the pipeline itself reads from the config.

    Attributes:
        runs: folder of the store.
        run: name for what a command makes, or None to name it by its content.
        executor: where shards run.
    """

    @dataclass(frozen=True)
    class Executor:
        kind: str
        workers: int
        address: str | None = None

    runs: Path
    executor: Executor
    run: str | None = None


def make(name: str, cfg: DictConfig, given: Mapping[str, StoredArtifact] | None = None) -> StoredArtifact:
    """The artifact of a stage under a config; made where it is not there yet, with all that it needs.

    Args:
        name: the stage.
        cfg: the composed config.
        given: artifacts to take as they are, stage name -> artifact, instead of what the config would make.

    Raises:
        EdreamError: a setting or an input is wrong, the disk is full, or an artifact that is needed is corrupt.
    """
    plumbing = config.read(cfg, Plumbing)
    places = executor.create(plumbing.executor.kind, plumbing.executor.workers, plumbing.executor.address)
    return _Maker(cfg, Store(plumbing.runs), places, dict(given or {})).make(name)


def make_run(command: str, names: Sequence[str], cfg: DictConfig) -> tuple[dict[str, StoredArtifact], Path]:
    """Make several stages and write down the run, so that `gc` keeps them.

    Args:
        command: what the user typed, for the record.
        names: the stages, the most important first.
        cfg: the composed config.

    Returns:
        The artifacts asked for and then all that they were made from, and the file that names them.
    """
    store = open_store(cfg)
    foresee(names, cfg)
    with store.session():
        made = {name: make(name, cfg) for name in names}
        for artifact in list(made.values()):
            made |= {name: one for name, one in chain(store, artifact).items() if name not in made}
        keys = {name: artifact.key for name, artifact in made.items()}
        name = config.read(cfg, Plumbing).run or hashlib.sha256(kinds.canonical([command, keys])).hexdigest()[:10]
        if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_.-]*", name):
            raise EdreamError(f"run={name!r} cannot be a run's name; expected letters, digits, '.', '_' and '-' only.")
        record = {"command": command, "made": keys}
        path = store.run_file(name)
        if store.runs().get(name) != record:
            store.name_run(name, record)
    return made, path


def foresee(names: Sequence[str], cfg: DictConfig) -> None:
    """Read the settings and look for the files of all that making these stages takes.

    So that what is wrong for the last stage is told before the first has worked for an hour.

    Raises:
        EdreamError: a setting is wrong, or a file is not there.
    """
    seen: set[tuple[str, ...]] = set()
    found: set[tuple[str, str]] = set()

    def look(need: str, cfg: DictConfig, changes: tuple[str, ...]) -> None:
        name, changes = stage_of(need), (*changes, *need.split(" ")[1:])
        if (name, *changes) in seen:
            return
        seen.add((name, *changes))
        cfg = under(cfg, need) if name != need else cfg
        entry = stage(name)
        settings = config.read(cfg, entry.config)
        if (name, repr(settings)) not in found:
            found.add((name, repr(settings)))
            for source in _sources(entry, settings).values():
                if isinstance(source, Path) and not source.exists():
                    source_digest(source)
        for one in entry.needs_for(settings):
            look(one, cfg, changes)

    for name in names:
        look(name, cfg, ())


def follow(name: str, cfg: DictConfig) -> None:
    """Help the process that makes a stage, from what the stage is made from; returns when that process is done.

    Raises:
        EdreamError: a setting or an input is wrong.
    """
    entry = stage(name)
    settings = config.read(cfg, entry.config)
    inputs = {need: make(need, cfg) for need in entry.needs_for(settings)}
    if entry.follow is not None:
        with TemporaryDirectory() as folder:
            entry.follow(inputs, settings, Path(folder))


def open_store(cfg: DictConfig) -> Store:
    """The store that the config names."""
    return Store(config.read(cfg, Plumbing).runs)


def stage(name: str) -> Stage:
    """A stage by its name.

    Raises:
        EdreamError: there is no such stage.
    """
    return catalog.load("stages", name, Stage)


def check_settings(cfg: DictConfig) -> None:
    """Refuse settings that no stage reads: misspelt ones in a config file of the user's own.

    Raises:
        EdreamError: naming the setting.
    """
    config.check_known(cfg, [*(stage(name).config for name in catalog.names("stages")), Plumbing])


def chain(store: Store, artifact: StoredArtifact) -> dict[str, StoredArtifact]:
    """An artifact and everything it was made from, need -> artifact; of what was made under other settings, only that itself."""
    found = {artifact.stage: artifact}
    for need, key in artifact.manifest["parents"].items():
        parent = store.find(stage_of(need), key)
        if parent is not None and need not in found:
            inside = chain(store, parent) if need == parent.stage else {need: parent}
            found |= {k: v for k, v in inside.items() if k not in found}
    return found


def under(cfg: DictConfig, need: str) -> DictConfig:
    """The config under which a need is made."""
    changed = cfg.copy()
    for setting in need.split(" ")[1:]:
        name, _, _ = setting.partition("=")
        OmegaConf.update(changed, name, OmegaConf.select(OmegaConf.from_dotlist([setting]), name))
    return changed


@dataclass(frozen=True)
class Step:
    """One stage in a plan: what exists of it, and what of its key is new against the most similar artifact there is.

    Attributes:
        stage: its name.
        key: its key, or None where an input must be made first.
        state: "made", "partly made" (a killed run left shards), "not made" or "waits for <stage>".
        changes: fields of the key that differ from the artifact of this stage that differs least, each with its old and new value.
    """

    stage: str
    key: str | None
    state: str
    changes: tuple[str, ...] = ()


def plan(name: str, cfg: DictConfig) -> list[Step]:
    """What `make` would find and do, in order, without doing it."""
    store = open_store(cfg)
    artifacts = store.artifacts()[::-1]
    steps: dict[str, Step] = {}

    def look(need: str, cfg: DictConfig) -> StoredArtifact | None:
        name, cfg = stage_of(need), under(cfg, need)
        entry = stage(name)
        settings = config.read(cfg, entry.config)
        inputs = {one: look(one, cfg) for one in entry.needs_for(settings)}
        missing = [one for one, artifact in inputs.items() if artifact is None]
        if missing:
            steps[need] = Step(need, None, f"waits for {missing[0]}")
            return None
        key_fields = _key_fields(entry, settings, {one: artifact for one, artifact in inputs.items() if artifact is not None})
        key = _key(key_fields)
        found = store.find(name, key)
        others = [tuple(differences(one.manifest["fields"], key_fields)) for one in artifacts if one.stage == name]
        changes = min(others, key=len, default=()) if found is None else ()
        state = "made" if found else "partly made" if store.work(name, key).is_dir() else "not made"
        steps[need] = Step(need, key, state, changes)
        return found

    look(name, cfg)
    return list(steps.values())


def differences(old: Any, new: Any, where: str = "") -> Iterator[str]:
    """What differs between two nested values, one "name: old -> new" each."""
    if isinstance(old, Mapping) and isinstance(new, Mapping):
        for key in sorted(old.keys() | new.keys()):
            yield from differences(old.get(key), new.get(key), f"{where}.{key}" if where else str(key))
    elif old != new:
        yield f"{where}: {_brief(old)} -> {_brief(new)}"


def _brief(value: Any) -> Any:
    """A digest by its first digits."""
    return f"{value[:8]}..." if isinstance(value, str) and re.fullmatch("[0-9a-f]{64}", value) else value


@dataclass(frozen=True)
class _Maker:
    cfg: DictConfig
    store: Store
    places: executor.Executor
    made: dict[str, StoredArtifact]

    def make(self, need: str) -> StoredArtifact:
        if need in self.made:
            return self.made[need]
        name = stage_of(need)
        if name != need:
            self.made[need] = self.elsewhere(under(self.cfg, need)).make(name)
            return self.made[need]
        entry = stage(name)
        settings = config.read(self.cfg, entry.config)
        inputs = {need: self.make(need) for need in entry.needs_for(settings)}
        key_fields = _key_fields(entry, settings, inputs)
        key = _key(key_fields)
        found = self.store.find(name, key)
        if found is None:
            with (
                self.store.session(),
                self.store.lock(name, key, lambda: _say(f"{name}: another process makes this; waiting for it")),
            ):
                found = self.store.find(name, key) or self.run(entry, settings, inputs, key_fields)
        self.made[name] = found
        return found

    def elsewhere(self, cfg: DictConfig) -> "_Maker":
        """The maker under another config, which knows what was made already and would be the same there."""

        def same(name: str, above: frozenset[str] = frozenset()) -> bool:
            if name in above:  # a stage may need itself under other settings, as rounds of learning do
                return True
            entry = stage(name)
            settings = config.read(cfg, entry.config)
            needs = map(stage_of, entry.needs_for(settings))
            return settings == config.read(self.cfg, entry.config) and all(same(need, above | {name}) for need in needs)

        kept = {need: one for need, one in self.made.items() if need == one.stage and same(need)}
        return _Maker(cfg, self.store, self.places, kept)

    def run(
        self, entry: Stage, settings: Any, inputs: Mapping[str, StoredArtifact], key_fields: Mapping[str, Any]
    ) -> StoredArtifact:
        key = _key(key_fields)
        if sys.stderr.isatty():
            _say(f"{entry.name} ...")
        started, clock = datetime.now(UTC), time.perf_counter()
        work = StageWork(self.store, entry.name, key, self.places)
        with writing(self.store.root):
            bundle = entry.run(inputs, settings, work)
        parents = {need: artifact.key for need, artifact in inputs.items()}
        about = {"fields": key_fields, "parents": parents, "made": _made(started, work.earlier + time.perf_counter() - clock)}
        return self.store.publish({"stage": entry.name, "key": key, **about}, bundle)


def _key_fields(entry: Stage, settings: Any, inputs: Mapping[str, StoredArtifact]) -> dict[str, Any]:
    """All that a key is the hash of, as plain JSON values."""
    return kinds.plain(
        {
            "stage": entry.name,
            "version": entry.version,
            "config": _without_paths(asdict(settings)),
            "inputs": {need: artifact.digest for need, artifact in inputs.items()},
            "sources": {name: source_digest(source) for name, source in _sources(entry, settings).items()},
            "numerics": _numerics(entry.numerics),
        }
    )


def _sources(entry: Stage, settings: Any) -> Mapping[str, Source]:
    return entry.sources(settings) if entry.sources else _paths(settings)


def _key(key_fields: Mapping[str, Any]) -> str:
    return hashlib.sha256(kinds.canonical(key_fields)).hexdigest()[:20]


def source_digest(source: Source) -> str:
    """Hash of the content of a file, of a folder with the names in it, or of bytes.

    Raises:
        EdreamError: nothing lies there.
    """
    if isinstance(source, bytes):
        return hashlib.sha256(source).hexdigest()
    if source.is_file():
        return kinds.file_digest(source)
    if not source.is_dir():
        raise EdreamError(f"There is nothing at {source}. Expected a file or a folder.")
    total = hashlib.sha256()
    for path in sorted(path for path in source.rglob("*") if path.is_file()):
        total.update(f"{path.relative_to(source).as_posix()}\0{kinds.file_digest(path)}\n".encode())
    return total.hexdigest()


def _paths(settings: Any, where: str = "") -> dict[str, Source]:
    found: dict[str, Source] = {}
    for field in fields(settings):
        value = getattr(settings, field.name)
        if isinstance(value, Path):
            found[where + field.name] = value
        elif hasattr(value, "__dataclass_fields__"):
            found |= _paths(value, f"{where}{field.name}.")
    return found


def _without_paths(values: Any) -> Any:
    if isinstance(values, Mapping):
        return {name: _without_paths(value) for name, value in values.items() if not isinstance(value, Path)}
    return values


def _numerics(packages: tuple[str, ...]) -> dict[str, str]:
    found = {package: version(package) for package in packages}
    if "torch" in packages:
        found["torch threads"] = os.environ.get("OMP_NUM_THREADS") or str(cores())
        if os.environ.get("WORLD_SIZE", "1") != "1":
            found["torch processes"] = os.environ["WORLD_SIZE"]
    return found


def _made(started: datetime, seconds: float) -> dict[str, Any]:
    """Who, when and where: for reading, never for keys."""
    return {
        "at": started.isoformat(timespec="milliseconds"),
        "seconds": round(seconds, 3),
        "git": _commit(),
        "argv": [Path(sys.argv[0]).name, *sys.argv[1:]],
        "versions": {"edream": __version__} | {package: version(package) for package in PACKAGES},
        "machine": {"system": platform.platform(), "python": platform.python_version(), "cores": cores()},
    }


def _commit() -> str | None:
    """The commit of edream's own checkout, or None where it is installed."""
    root = Path(__file__).parent.parent
    if not (root / ".git").exists():
        return None
    try:
        found = subprocess.run(["git", "-C", str(root), "rev-parse", "HEAD"], capture_output=True, text=True, timeout=10)
    except (FileNotFoundError, subprocess.TimeoutExpired):
        return None
    return found.stdout.strip() or None


def _say(text: str) -> None:
    sys.stderr.write(f"{text}\n")
