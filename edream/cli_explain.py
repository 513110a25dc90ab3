"""Commands that tell: explain, doctor."""

import importlib
import inspect
import json as json_
import os
import platform
import re
import subprocess
import sys
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from omegaconf import OmegaConf

from edream import catalog, cli_show, config
from edream.core.cores import cores
from edream.core.errors import unknown_name

PACKAGES = (
    *("mujoco", "numpy", "scipy", "torch", "pyarrow", "h5py", "av", "mcap", "hydra-core", "safetensors", "cma"),
    *("diffusers", "scikit-image"),
)
RENDER = """
import mujoco, OpenGL.GL as gl
context = mujoco.GLContext(64, 64); context.make_current()
print(gl.glGetString(gl.GL_RENDERER).decode())
"""


def explain(name: str, json: bool) -> None:
    """Print what an entry of any catalog is, from its own docstring.

    Raises:
        EdreamError: no catalog has such an entry.
    """
    if "." in name:
        explain_setting(name, json)
        return
    folders = _catalogs()
    places = [folder for folder in folders if name in catalog.names(folder)]
    if not places:
        raise unknown_name("entry", name, {entry for folder in folders for entry in catalog.names(folder)})
    found = [{"name": name, "catalog": place, "text": _text(importlib.import_module(f"edream.{place}.{name}"))} for place in places]
    if json:
        print(json_.dumps({"name": name, "entries": found}, indent=2))
    else:
        print("\n\n".join(f"{name} ({one['catalog']})\n\n{one['text']}" for one in found))


def explain_setting(name: str, json: bool) -> None:
    """Print what a setting such as `fit.compare` starts from, and what the config says about it.

    Raises:
        EdreamError: there is no such setting.
    """
    group = name.partition(".")[0]
    known = {}
    for file in sorted(config.conf_folder().glob(f"{group}/*.yaml")):
        parents: list[tuple[int, str]] = []
        for line in file.read_text().splitlines():
            found = re.match(r"( *)([\w.]+): *([^#]*?) *(?:# *(.*))?$", line)
            if found and found[2] != "defaults":
                parents = [*(one for one in parents if one[0] < len(found[1])), (len(found[1]), found[2])]
                setting = ".".join([group, *(key for _, key in parents)])
                known.setdefault(setting, []).append({"in": f"{group}={file.stem}", "value": found[3], "text": found[4] or ""})
    if name not in known:
        settings = known or {path.name: None for path in config.conf_folder().iterdir() if path.is_dir()}
        raise unknown_name("setting" if known else "group of settings", name if known else group, settings)
    if json:
        print(json_.dumps({"name": name, "settings": known[name]}, indent=2))
    else:
        lines = [f"{one['in']}: {one['value'] or 'a group'}  {one['text']}" for one in known[name]]
        print("\n".join([f"{name} (setting)", "", *lines]))


def doctor(json: bool) -> None:
    """Print versions, cores, what can be rendered, and what of each experiment of `conf/experiment/` can run here."""
    found = {
        "edream": _version("edream") or "from a checkout",
        "python": platform.python_version(),
        "system": platform.platform(),
        "cores": cores(),
        "OMP_NUM_THREADS": os.environ.get("OMP_NUM_THREADS"),
        "packages": {name: _version(name) or "missing" for name in PACKAGES},
        "rendering": {kind: _renderer(kind) for kind in ("egl", "osmesa")},
    }
    found["torch threads"], found["gpu"], broken = _torch()
    if broken:
        found["packages"]["torch"] += f", broken: {broken}"
    found["memory [GB]"] = round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 1e9, 1)
    missing = [name for name, there in found["packages"].items() if there == "missing"]
    draws = [kind for kind, renderer in found["rendering"].items() if not renderer.startswith("no")]
    found["can run"] = {
        "ingest, calibrate, diagnose, replay": "yes" if not missing else f"no: {', '.join(missing)} missing",
        "rendering": f"yes, MUJOCO_GL={draws[0]}" if draws else "no: neither EGL nor OSMesa works; install libegl1 or libosmesa6",
    }
    found["experiments"] = {file.stem: _experiment(file.stem, found) for file in _experiments()}
    if json:
        print(json_.dumps(found, indent=2))
    else:
        cli_show.table(found)


def _experiments() -> list[Path]:
    return sorted((config.conf_folder() / "experiment").glob("*.yaml"))


def _experiment(name: str, found: Mapping[str, Any]) -> str:
    """What of an experiment this machine can run, and what stands in the way of the rest."""
    cfg = config.compose([f"experiment={name}"])
    robot = f"{cfg.robot.name}, " if cfg.robot.get("name") else ""
    give = "with data=PATH" if OmegaConf.is_missing(cfg, "data") else "as it is"
    give += " robot.mjcf=PATH" if OmegaConf.is_missing(cfg.robot, "mjcf") else ""
    first = "yes" if found["can run"]["ingest, calibrate, diagnose, replay"] == "yes" else "no"
    cuda = [part for part in ("dream", "policy") if cfg[part].device == "cuda" and not found["gpu"]]
    reasons = [found["can run"]["rendering"].removeprefix("no: ")] if found["can run"]["rendering"].startswith("no") else []
    reasons += [f"{' and '.join(f'{part}.device' for part in cuda)} ask for a GPU, and there is none"] if cuda else []
    reasons += ["torch cannot be loaded"] if "broken" in found["packages"]["torch"] else []
    alone = cfg.render.model == "none"  # video of a robot for which there is no model
    rest = f"no: {'; '.join(reasons)}" if reasons else f"yes, given video{'' if alone else ' and a task'}"
    return f"{robot}{give}: dream {rest}" if alone else f"{robot}{give}: calibrate, diagnose {first}; dream, train-policy {rest}"


def _catalogs() -> list[str]:
    """Folders of the package whose files are entries."""
    root = Path(__file__).parent
    folders = sorted(path.parent.name for path in root.glob("*/__init__.py"))
    return [folder for folder in folders if any("\nENTRY" in path.read_text() for path in (root / folder).glob("[!_]*.py"))]


def _text(module: Any) -> str:
    entry = module.ENTRY
    own = inspect.getdoc(type(entry)) if type(entry).__module__ == module.__name__ else None
    parts = [inspect.getdoc(module), own, getattr(entry, "summary", None)]
    return "\n\n".join(dict.fromkeys(part for part in parts if part))


def _renderer(kind: str) -> str:
    """Name of the renderer behind MuJoCo's classic renderer, asked of another process: a broken driver can end it."""
    environment = os.environ | {"MUJOCO_GL": kind, "PYOPENGL_PLATFORM": kind}
    asked = subprocess.run([sys.executable, "-c", RENDER], env=environment, capture_output=True, text=True, timeout=60)
    lines = (asked.stdout if asked.returncode == 0 else asked.stderr).strip().splitlines()
    return lines[-1] if asked.returncode == 0 and lines else f"no: {lines[-1] if lines else f'exit code {asked.returncode}'}"


def _torch() -> tuple[int | None, str | None, str | None]:
    """Torch's threads, the GPU that it finds, and why it cannot be used where it is there and cannot."""
    if _version("torch") is None:
        return None, None, None
    try:
        import torch
    except ImportError as error:
        return None, None, str(error)
    return torch.get_num_threads(), torch.cuda.get_device_name(0) if torch.cuda.is_available() else None, None


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None
