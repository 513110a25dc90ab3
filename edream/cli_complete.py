"""Shell completion: the script that a shell reads, and the words that settings begin with."""

import os
from collections.abc import Iterator

from edream import catalog
from edream.core.errors import unknown_name

VARIABLE = "_EDREAM_COMPLETE"
SHELLS = ("bash", "zsh", "fish")
ENTRIES = {"fit.method": "fitters", "masks.segmenter": "segmenters", "policy.kind": "policies", "policy.rl": "preferences"}
ENTRIES |= {"task": "tasks", "ingest.format": "formats", "record.format": "formats", "surrogate.kind": "surrogates"}


def script(shell: str) -> str:
    """What a shell reads to complete edream's commands.

    Raises:
        EdreamError: there is no such shell.
    """
    from typer._completion_shared import get_completion_script

    if shell not in SHELLS:
        raise unknown_name("shell", shell, SHELLS)
    whole = 'COMP_WORDBREAKS="${COMP_WORDBREAKS//=}"\n' if shell == "bash" else ""  # else bash takes robot=so for three words
    return whole + get_completion_script(prog_name="edream", complete_var=VARIABLE, shell=shell)


def begin() -> None:
    """Teach the command line the protocol of those scripts, where a shell asks."""
    if VARIABLE in os.environ:
        from typer._completion_classes import completion_init

        completion_init()


def settings(incomplete: str) -> list[str]:
    """Settings that begin so: `robot=so101` for `robot=`, `fit.method=` for `fit.m`."""
    return sorted(word for word in _words(incomplete) if word.startswith(incomplete))


def _words(incomplete: str) -> Iterator[str]:
    from edream import config

    name, equals, _ = incomplete.partition("=")
    groups = {path.name: path for path in config.conf_folder().iterdir() if path.is_dir()}
    if equals and name in groups:
        yield from (f"{name}={file.stem}" for file in groups[name].glob("*.yaml"))
    elif equals and name in ENTRIES:
        yield from (f"{name}={entry}" for entry in catalog.names(ENTRIES[name]))
    elif not equals and "." in name:
        group = groups.get(name.partition(".")[0])
        for file in sorted(group.glob("*.yaml")) if group else []:
            keys = (line.partition(":")[0] for line in file.read_text().splitlines() if ":" in line and line[:1].isalpha())
            yield from (f"{file.parent.name}.{key}=" for key in keys if key != "defaults")
    elif not equals:
        yield from (f"{group}=" for group in groups)
        yield from (f"{group}." for group in groups)
        yield from ("data=", "runs=", "run=", "seed=", "task=")
