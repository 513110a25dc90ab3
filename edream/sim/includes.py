"""MJCF that is split over files, put together: each `<include file="..."/>` becomes what its file holds."""

import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path

from edream.core.errors import EdreamError


def merged(text: str, path: Path, read: Callable[[str], str]) -> str:
    """A model's text with every include in its place; the text as it is where there is none.

    Source: "include" in MuJoCo's XML reference: names are relative to the main file's folder, and each file comes in once.

    Args:
        text: the main file.
        path: where that lies, for what is said of mistakes.
        read: the text of an included file, by the name that stands in `file`.

    Raises:
        EdreamError: a text is no XML, an include names no file, or one comes in twice.
    """
    if "<include" not in text:
        return text
    root = _parsed(text, path)
    _fill(root, path, read, set())
    return ET.tostring(root, encoding="unicode")


def _fill(element: ET.Element, path: Path, read: Callable[[str], str], met: set[str]) -> None:
    children: list[ET.Element] = []
    for child in element:
        if child.tag != "include":
            _fill(child, path, read, met)
            children.append(child)
            continue
        name = child.get("file")
        if not name:
            raise EdreamError(f"Robot model {path}: an <include> names no file.")
        if name in met:
            raise EdreamError(f"Robot model {path} includes {name!r} twice; MuJoCo takes each file once.")
        met.add(name)
        inner = _parsed(read(name), path.parent / name)
        _fill(inner, path, read, met)
        children += list(inner)
    element[:] = children


def _parsed(text: str, path: Path) -> ET.Element:
    try:
        return ET.fromstring(text)
    except ET.ParseError as error:
        raise EdreamError(f"Robot model {path} is not XML: {error}.") from error
