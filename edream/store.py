"""The store: artifacts that are whole or absent, never changed, and checked whenever they are read.

    runs/<stage>/<key>/          one artifact: its data and manifest.json
    runs/<stage>/.work-<key>/    finished shards of a stage that is not finished
    runs/run-<name>.json         what one command made; keeps it from `gc`
    runs/.locks/                 one lock for each key being made, and one for the whole store

An artifact is written under a temporary name, flushed, and renamed; its manifest is written last. A process that dies leaves
at most a temporary folder, which the next one removes. Locks are `flock`s, which the kernel drops when a process dies.
"""

import errno
import fcntl
import hashlib
import json
import os
import platform
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from edream import kinds
from edream.core.errors import EdreamError, unknown_name
from edream.core.stage import Artifact, Bundle, stage_of
from edream.kinds import failpoint

MANIFEST = "manifest.json"
KEY_LENGTH = 20


class StoredArtifact(Artifact):
    """One published folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.manifest = read_checked(folder / MANIFEST)
        self.stage: str = self.manifest["stage"]
        self.key: str = self.manifest["key"]
        self.digest: str = self.manifest["digest"]
        self.seconds: float = self.manifest.get("made", {}).get("seconds", 0.0)
        self._checked: set[str] = set()

    def __iter__(self) -> Iterator[str]:
        return iter(self.manifest["files"])

    def __len__(self) -> int:
        return len(self.manifest["files"])

    def __getitem__(self, name: str) -> Any:
        return kinds.read(self.path(name))

    def __contains__(self, name: object) -> bool:
        return name in self.manifest["files"]

    def path(self, name: str) -> Path:
        if name not in self:
            raise unknown_name(f"file in the artifact {self.folder}:", name, self)
        if name not in self._checked:
            problem = self.problem(name)
            if problem:
                raise EdreamError(problem)
            self._checked.add(name)
        return self.folder / name

    def problem(self, name: str) -> str | None:
        """What is wrong with a file of this artifact, in a sentence; None where its bytes are those that were written."""
        path = self.folder / name
        if not path.is_file():
            return f"{path} is missing. Remove the folder {self.folder} and run the command again: it will be made anew."
        if kinds.file_digest(path) != self.manifest["files"][name]["sha256"]:
            return (
                f"{path} is corrupt: its bytes are not those that were written. Remove the folder {self.folder} "
                "and run the command again: it will be made anew."
            )
        return None


class Store:
    """A folder of artifacts, shared by any number of processes on one machine."""

    def __init__(self, root: Path) -> None:
        self.root = Path(root)

    def folder(self, stage: str, key: str) -> Path:
        return self.root / stage / key

    def work(self, stage: str, key: str) -> Path:
        """Where a stage keeps its finished shards until its artifact is published."""
        return self.root / stage / f".work-{key}"

    def find(self, stage: str, key: str) -> StoredArtifact | None:
        """The artifact with this key, or None where it was not made."""
        folder = self.folder(stage, key)
        return StoredArtifact(folder) if (folder / MANIFEST).exists() else None

    def artifacts(self) -> list[StoredArtifact]:
        """All artifacts, oldest first.

        Raises:
            EdreamError: a manifest is corrupt.
        """
        return sorted(
            (StoredArtifact(path.parent) for path in self._manifests()),
            key=lambda artifact: (artifact.manifest["made"]["at"], artifact.key),
        )

    def publish(self, manifest: Mapping[str, Any], bundle: Bundle) -> StoredArtifact:
        """Write an artifact; it appears whole, with the fields of `manifest`, or not at all."""
        stage, key = manifest["stage"], manifest["key"]
        artifact = publish(self.folder(stage, key), manifest, bundle)
        shutil.rmtree(self.work(stage, key), ignore_errors=True)
        return artifact

    @contextmanager
    def session(self) -> Iterator[None]:
        """Hold off `gc` while artifacts are made and read."""
        with _locked(self.root / ".locks" / "store", fcntl.LOCK_SH):
            yield

    @contextmanager
    def lock(self, stage: str, key: str, waiting: Callable[[], None]) -> Iterator[None]:
        """Be the only process that makes this artifact; `waiting` is called when another one is at it."""
        with _locked(self.root / ".locks" / f"{stage}-{key}", fcntl.LOCK_EX, waiting):
            folder = self.root / stage
            for left in [*folder.glob(f".tmp-{key}-*"), *self.work(stage, key).glob("*/.tmp-*")]:
                shutil.rmtree(left)
            yield

    def run_file(self, name: str) -> Path:
        """The file that says what a run made."""
        return self.root / f"run-{name}.json"

    def name_run(self, name: str, record: Mapping[str, Any]) -> Path:
        """Write down what a command made, as `run-<name>.json`."""
        path = self.run_file(name)
        temporary = self.root / f".tmp-run-{name}-{os.getpid()}.json"
        with writing(self.root):
            write_checked(record, temporary)
            failpoint("run")
            os.replace(temporary, path)
            failpoint("named")
            _flush(self.root)
        return path

    def runs(self) -> dict[str, dict[str, Any]]:
        """Run name -> what it made.

        Raises:
            EdreamError: the file of a run is corrupt.
        """
        return {path.stem.removeprefix("run-"): read_checked(path) for path in sorted(self.root.glob("run-*.json"))}

    def verify(self) -> list[str]:
        """Every file that is not what was written, one sentence each."""
        problems = []
        for path in self._manifests():
            try:
                artifact = StoredArtifact(path.parent)
            except EdreamError as error:
                problems.append(str(error))
                continue
            problems += [problem for name in artifact if (problem := artifact.problem(name))]
            known = {MANIFEST, *artifact}
            extra = [p for p in sorted(path.parent.rglob("*")) if p.is_file() and str(p.relative_to(path.parent)) not in known]
            problems += [f"{stray} does not belong to the artifact in {path.parent}; remove it." for stray in extra]
        for path in sorted(self.root.glob("run-*.json")):
            try:
                made = read_checked(path)["made"]
            except EdreamError as error:
                problems.append(str(error))
                continue
            named = [(stage_of(need), key) for need, key in made.items()]
            gone = [f"{stage}/{key}" for stage, key in named if not (self.folder(stage, key) / MANIFEST).exists()]
            problems += [f"{path} names {name}, which does not exist; run its command again or remove {path}." for name in gone]
        return problems

    def gc(self, forget: Sequence[str] = ()) -> list[Path]:
        """Remove what no run names, directly or as a parent, and what killed processes left; return what was removed.

        Args:
            forget: runs to forget first.

        Raises:
            EdreamError: a process is at work in this store, or a manifest is corrupt, so that it is not known what is needed.
        """
        if not self.root.is_dir():
            return []
        with _locked(self.root / ".locks" / "store", fcntl.LOCK_EX, self._refuse), writing(self.root):
            for name in forget:
                self.run_file(name).unlink()
            artifacts = {(a.stage, a.key): a for a in map(StoredArtifact, [path.parent for path in self._manifests()])}
            needed: set[tuple[str, str]] = set()
            open_ = [(stage_of(need), key) for run in self.runs().values() for need, key in run["made"].items()]
            while open_:
                one = open_.pop()
                if one in artifacts and one not in needed:
                    needed.add(one)
                    open_ += [(stage_of(need), key) for need, key in artifacts[one].manifest["parents"].items()]
            unneeded = [artifacts[one].folder for one in sorted(artifacts.keys() - needed)]
            left = [*self.root.glob("*/.tmp-*"), *self.root.glob("*/.work-*"), *self.root.glob(".tmp-*")]
            for folder in [*unneeded, *left]:
                _remove(folder)
            for lock in (self.root / ".locks").glob("*-*"):
                lock.unlink()
            return [*unneeded, *left]

    def _refuse(self) -> None:
        raise EdreamError(f"Another process is at work in {self.root}; nothing was removed. Run gc again when it is done.")

    def _manifests(self) -> list[Path]:
        return sorted(path for path in self.root.glob(f"*/*/{MANIFEST}") if not path.parent.name.startswith("."))


def publish(folder: Path, manifest: Mapping[str, Any], bundle: Bundle) -> StoredArtifact:
    """Write `bundle` and its manifest as `folder`, in one rename. Where the folder is there already, it stays as it is."""
    temporary = folder.parent / f".tmp-{folder.name}-{platform.node()}-{os.getpid()}"
    with writing(folder.parent):
        try:
            temporary.mkdir(parents=True)
            files = {}
            for name, value in sorted(bundle.items()):
                failpoint("write")
                files[name] = _write(temporary, name, value)
            content = hashlib.sha256(kinds.canonical({name: entry["logical"] for name, entry in files.items()})).hexdigest()
            failpoint("manifest")
            write_checked({**manifest, "files": files, "digest": content}, temporary / MANIFEST)
            failpoint("flush")
            for inner in {path.parent for path in temporary.rglob("*")}:
                _flush(inner)
            failpoint("rename")
            try:
                os.rename(temporary, folder)
            except OSError as error:
                if error.errno not in (errno.ENOTEMPTY, errno.EEXIST):
                    raise
            failpoint("renamed")
            _flush(folder.parent)
        finally:
            shutil.rmtree(temporary, ignore_errors=True)
    return StoredArtifact(folder)


def write_checked(fields: Mapping[str, Any], path: Path) -> None:
    """Write fields as canonical JSON that carries its own hash, so that `read_checked` notices any change of any byte."""
    kinds.write({**fields, "check": hashlib.sha256(kinds.canonical(fields)).hexdigest()}, path)


def read_checked(path: Path) -> dict[str, Any]:
    """Fields that `write_checked` wrote.

    Raises:
        EdreamError: the bytes are not those that were written.
    """
    raw = path.read_bytes()
    try:
        parsed = json.loads(raw)
        check = parsed.pop("check")
        whole = kinds.canonical({**parsed, "check": check}) == raw and hashlib.sha256(kinds.canonical(parsed)).hexdigest() == check
    except (ValueError, KeyError, AttributeError, TypeError):
        whole, parsed = False, {}
    if not whole:
        what = path.parent if path.name == MANIFEST else path
        raise EdreamError(f"{path} is corrupt: its bytes are not those that were written. Remove {what} and run the command again.")
    return parsed


FULL = {
    errno.ENOSPC: "the disk is full",
    errno.EDQUOT: "your disk quota is used up",
    errno.EFBIG: "the file size limit was reached",
    errno.EROFS: "it lies on a read-only disk",
}
REFUSED = {errno.EACCES: "you may not write there", errno.EPERM: "you may not write there"}
NO_FOLDER = dict.fromkeys((errno.ENOTDIR, errno.EEXIST, errno.ENOENT), "no folder can be made there")


@contextmanager
def writing(where: Path) -> Iterator[None]:
    """Turn a disk that is full, or a folder `where` that may not be written, into the one sentence that a user needs."""
    try:
        yield
    except OSError as error:
        file = str(error.filename or "")
        there = file and (file.startswith(str(where)) or str(where).startswith(file))
        reason = (FULL | REFUSED | NO_FOLDER if there else FULL).get(error.errno or 0)
        if reason is None:
            raise
        raise EdreamError(
            f"Cannot write {file or where}: {reason}. All finished work is kept; "
            "mend that, or name another folder with runs=DIR, and run the same command again."
        ) from error


def _write(folder: Path, name: str, value: Any) -> dict[str, Any]:
    path = folder / name
    if Path(name).is_absolute() or ".." in Path(name).parts or name == MANIFEST:
        raise ValueError(f"{name!r} cannot be the name of a file in an artifact")
    path.parent.mkdir(parents=True, exist_ok=True)
    if isinstance(value, Path):
        _take(value, path)
    else:
        kinds.write(value, path)
    path.chmod(0o444)
    failpoint("fsync")
    return {"bytes": path.stat().st_size, "sha256": kinds.file_digest(path), "logical": kinds.digest(path)}


def _take(source: Path, path: Path) -> None:
    """A file of this store's own work folders itself, for it will not change any more; a copy of any other; flushed."""
    if any(part.startswith(".work-") for part in source.parts):
        os.link(source, path)
    else:
        shutil.copyfile(source, path)
    failpoint("written")
    _flush(path)


def _flush(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _remove(path: Path) -> None:
    if not path.is_dir():
        path.unlink()
        return
    gone = path.with_name(f".tmp-removed-{path.name}")
    os.rename(path, gone)
    shutil.rmtree(gone)


@contextmanager
def _locked(path: Path, how: int, waiting: Callable[[], None] | None = None) -> Iterator[None]:
    descriptor = _lock_file(path, how)
    try:
        try:
            fcntl.flock(descriptor, how | fcntl.LOCK_NB)
        except BlockingIOError:
            if waiting is not None:
                waiting()
            fcntl.flock(descriptor, how)
        yield
    finally:
        os.close(descriptor)


def _lock_file(path: Path, how: int) -> int:
    with writing(path.parent):
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            return os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        except OSError as error:
            if how == fcntl.LOCK_SH and error.errno in (errno.EROFS, errno.EACCES) and path.exists():
                return os.open(path, os.O_RDONLY)  # what a store holds that may not be written can still be read
            raise
