"""The file that says what stands around the robot and where."""

import json
from pathlib import Path

from edream.core.errors import EdreamError
from edream.core.scene import Scene, scene_from_json


def read_scene(path: Path | None) -> Scene:
    """The scene in a file; an empty one where there is none.

    Raises:
        EdreamError: it cannot be read.
    """
    if path is None:
        return Scene()
    if not path.is_file():
        raise EdreamError(f"There is no scene at {path}; expected JSON with objects and tracks.")
    try:
        return scene_from_json(json.loads(path.read_bytes()), str(path))
    except (ValueError, RecursionError) as error:
        raise EdreamError(f"{path} is no JSON: {error}.") from error
