"""What policies are called."""

import re

NAMES = {"sft": "SFT", "rl": "RL"}
BRIEF = 56  # characters


def label(need: str) -> str:
    """A policy as the table names it; of a path its last part, of an artifact's key as much as tells it."""
    name, *changes = need.split(" ")
    parts = (change.partition("=") for change in changes)
    return ", ".join([NAMES[name], *(f"{key}{sign}{_last(value)}" for key, sign, value in parts)])


def _last(value: str) -> str:
    last = value.rsplit("/", 1)[-1]
    return last[:6] if re.fullmatch("[0-9a-f]{20}", last) else last


def brief(name: str) -> str:
    """A row's name for headlines and titles: of many settings the first ones, of cameras their number; the table has them all."""
    first, *settings, views = name.split(", ")
    if len(name) > BRIEF:
        settings = [one for one in settings if not one.startswith("policy.cameras=")]
    kept: list[str] = []
    while settings and len(", ".join([first, *kept, settings[0], views])) <= BRIEF:
        kept.append(settings.pop(0))
    return ", ".join([first, *kept, *(["..."] if settings else []), views])
