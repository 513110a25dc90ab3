"""The config: composed by Hydra from `conf/` and the command line, then read into frozen dataclasses, strictly."""

import math
import re
import types
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import MISSING, fields, is_dataclass
from pathlib import Path
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from omegaconf import DictConfig, ListConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from edream.core.errors import EdreamError, unknown_name

T = TypeVar("T")
PATHS = frozenset(
    {"data", "runs", "robot.mjcf", "record.out", "record.truth", "replay.hook", "camera.file", "camera.marks", "render.scene"}
    | {"masks.plate", "masks.truth", "masks.folder", "masks.weights", "dream.codec.weights", "dream.denoiser.weights"}
    | {"score.weights.lpips", "score.weights.fvd"}
    | {"policy.objects", "rollouts.plate", "sft.change.folder", "evaluate.truth"}
)
# settings that hold names of the user's own, such as fit.fixed={servo_gain.kp: 18}; Hydra adds to them only where told so
OPEN = ("fit.fixed", "fit.limits", "fit.scaled", "robot.scaled", "surrogate.options", "masks.options", "dream.codec.options") + (
    *(f"ingest.mapping.{name}" for name in ("channels", "units", "scale", "offset")),
)
EXPECTED: dict[Any, str] = {
    int: "an integer",
    float: "a number",
    str: "text",
    bool: "true or false",
    Path: "a path",
    type(None): "null",
}


def conf_folder() -> Path:
    """Where the shipped config lies: inside the installed package, or beside it in a checkout."""
    package = Path(__file__).parent
    return package / "conf" if (package / "conf").is_dir() else package.parent / "conf"


def compose(overrides: Sequence[str] = (), conf: Path | None = None) -> DictConfig:
    """Compose the config of one command.

    Args:
        overrides: such as `robot=so101`, `fit.steps=50`, `data=PATH`; Hydra's grammar, but paths may be written as they are.
        conf: a folder of your own config files, searched before the shipped ones.

    Raises:
        EdreamError: an override names nothing that exists, or cannot be read.
    """
    from hydra import compose as hydra_compose
    from hydra import initialize_config_dir
    from hydra.core.global_hydra import GlobalHydra
    from hydra.errors import HydraException
    from yaml import YAMLError

    if conf is not None and not Path(conf).is_dir():
        raise EdreamError(f"There is no config folder {conf}; expected a folder with files such as robot/mine.yaml.")
    OmegaConf.register_new_resolver("package", lambda path: str(Path(__file__).parent / path), replace=True)
    search = [f"hydra.searchpath=[{_quoted(f'file://{Path(conf).resolve()}')}]"] if conf is not None else []
    ordered = [_with_quoted_path(override) for override in overrides]
    GlobalHydra.instance().clear()
    try:
        with initialize_config_dir(str(conf_folder()), version_base=None):
            config = hydra_compose("config", [*search, *ordered])
            OmegaConf.resolve(config)
            return config
    except (HydraException, OmegaConfBaseException, YAMLError, ValueError) as error:  # Hydra raises ValueError for robot=3
        raise _mended(error, ordered, search) from error
    finally:
        GlobalHydra.instance().clear()


def read(config: DictConfig, kind: type[T], where: str = "") -> T:
    """The part of a config that a frozen dataclass lists, checked against its types.

    Args:
        config: the composed config, or a group of it.
        kind: a dataclass whose field names are the config's keys; nested dataclasses read groups. Further keys are left alone.
        where: dotted name of the group, for messages.

    Raises:
        EdreamError: a value is missing or of the wrong type.
    """
    hints = get_type_hints(kind)
    values = {}
    for field in fields(kind):  # type: ignore[arg-type]
        name = f"{where}.{field.name}" if where else field.name
        if OmegaConf.is_missing(config, field.name):
            raise EdreamError(f"{name!r} is not set; it is needed: give {name}=VALUE on the command line.")
        if field.name not in config:
            if field.default is MISSING and field.default_factory is MISSING:
                raise EdreamError(f"The config has no {name!r}, which is needed: give {name}=VALUE.")
            continue
        values[field.name] = _convert(config[field.name], hints[field.name], name)
    return kind(**values)


def check_known(config: DictConfig, kinds: Iterable[type]) -> None:
    """Refuse keys that neither the shipped config has nor a dataclass of `kinds` reads: misspelt ones in a user's own files.

    Args:
        config: the composed config.
        kinds: the dataclasses that read it.

    Raises:
        EdreamError: naming the first unknown key and the nearest known one.
    """
    _check_group(config, list(kinds), compose(), "")


def _check_group(config: DictConfig, kinds: list[type], shipped: Any, where: str) -> None:
    known = {str(key) for key in shipped} if isinstance(shipped, DictConfig) else set()
    readers: dict[str, list[type]] = {}
    for kind in kinds:
        hints = get_type_hints(kind)
        for field in fields(kind):
            known.add(field.name)
            readers.setdefault(field.name, []).extend(filter(is_dataclass, _alternatives(hints[field.name])))
    for key in map(str, config):
        if key not in known:
            raise unknown_name(f"setting in {where or 'the config'}:", key, known)
        if readers.get(key) and isinstance(config._get_node(key), DictConfig):
            inside = shipped._get_node(key) if isinstance(shipped, DictConfig) and key in shipped else None
            _check_group(config[key], readers[key], inside, f"{where}.{key}" if where else key)


def _convert(value: Any, kind: Any, name: str) -> Any:
    origin = get_origin(kind)
    if origin in (Union, types.UnionType):
        return _convert_any(value, kind, name)
    if is_dataclass(kind):
        if not isinstance(value, DictConfig):
            raise EdreamError(f"{name} is {value!r}; expected a group of settings.")
        return read(value, kind, name)  # type: ignore[arg-type]
    if origin is Literal:
        if value not in get_args(kind):
            raise unknown_name(f"choice for {name}:", str(value), map(str, get_args(kind)))
        return value
    if origin is tuple:
        if not isinstance(value, ListConfig):
            raise EdreamError(f"{name} is {value!r}; expected a list: {name}=[...].")
        inner = get_args(kind)
        inner = (inner[0],) * len(value) if len(inner) == 2 and inner[1] is Ellipsis else inner
        if len(inner) != len(value):
            raise EdreamError(f"{name} has {len(value)} values; expected {len(inner)}.")
        return tuple(_convert(item, one, f"{name}[{i}]") for i, (item, one) in enumerate(zip(value, inner, strict=True)))
    if origin in (dict, Mapping) or (origin is not None and isinstance(origin, type) and issubclass(origin, Mapping)):
        if not isinstance(value, DictConfig):
            raise EdreamError(f"{name} is {value!r}; expected names with values: {{name: value}}.")
        inner = get_args(kind)[1]
        for key, item in value.items() if is_dataclass(inner) else ():
            known = [field.name for field in fields(inner)]
            for unknown in set(item) - set(known) if isinstance(item, DictConfig) else ():
                raise unknown_name(f"setting in {name}.{key}:", str(unknown), known)
        return {str(key): _convert(item, inner, f"{name}.{key}") for key, item in value.items()}
    if kind is Path and isinstance(value, str):
        return Path(value).expanduser()
    if name == "seed" and isinstance(value, int) and value < 0:
        raise EdreamError(f"seed is {value}; expected 0 or more.")
    if kind is float and isinstance(value, int | float) and not isinstance(value, bool):
        if not math.isfinite(value):
            raise EdreamError(f"{name} is {value}; expected a finite number.")
        return float(value)
    if kind is Any and isinstance(value, DictConfig | ListConfig):
        return OmegaConf.to_container(value, resolve=True)
    if kind is Any or (type(value) is kind):
        return value
    raise EdreamError(f"{name} is {value!r}; expected {_expected(kind)}.")


def _convert_any(value: Any, kind: Any, name: str) -> Any:
    choices = _alternatives(kind)
    if value is None and type(None) in choices:
        return None
    choices = [choice for choice in choices if choice is not type(None)]
    if len(choices) == 1:
        return _convert(value, choices[0], name)
    for choice in choices:
        try:
            return _convert(value, choice, name)
        except EdreamError:
            continue
    raise EdreamError(f"{name} is {value!r}; expected {_expected(kind)}.")


def _alternatives(kind: Any) -> list[Any]:
    return list(get_args(kind)) if get_origin(kind) in (Union, types.UnionType) else [kind]


def _expected(kind: Any) -> str:
    return " or ".join(EXPECTED.get(one, getattr(one, "__name__", str(one))) for one in _alternatives(kind))


def _quoted(text: str) -> str:
    escaped = text.replace("\\", "\\\\").replace("'", "\\'")
    return f"'{escaped}'"


def _with_quoted_path(override: str) -> str:
    key, equals, value = override.partition("=")
    if key in PATHS and equals and value not in ("", "null", "???") and value[0] not in "'\"$":
        return f"{key}={_quoted(value)}"
    opened = key in OPEN or key.startswith(tuple(f"{name}." for name in OPEN))
    return f"++{override}" if opened and equals else override


def _mended(error: Exception, overrides: Sequence[str], search: Sequence[str]) -> EdreamError:
    """Hydra's complaint as one sentence with the nearest thing that exists."""
    text = str(error)
    options = getattr(error, "options", None)
    missing = getattr(error, "missing_cfg_file", None)
    if missing and options:
        group, _, choice = str(missing).rpartition("/")
        return unknown_name(group or "config", choice, options)
    named = re.search(r"Could not (?:override|delete|append to config\. An item is already at) '([^']+)'", text)
    if named and "already" not in text:
        return _unknown_setting(named.group(1), overrides, search)
    first = " ".join(text.split("\n")[0].split())
    return EdreamError(f"The settings cannot be composed: {first} Expected NAME=VALUE, such as robot=so101 or fit.steps=50.")


def _unknown_setting(name: str, overrides: Sequence[str], search: Sequence[str]) -> EdreamError:
    group, dot, key = name.rpartition(".")
    pairs = [(override, override.partition("=")[0]) for override in overrides]
    chosen = [override for override, key in pairs if key in _groups() and key != name]
    default = compose(chosen) if not search else compose(())
    while True:
        inside = OmegaConf.select(default, group) if group else default
        if isinstance(inside, DictConfig):
            known = [str(k) for k in inside]
            return unknown_name(f"setting in {group}:" if dot else "setting", key, known)
        group, dot, key = group.rpartition(".")


def _groups() -> set[str]:
    return {path.name for path in conf_folder().iterdir() if path.is_dir()}
