"""Views: each recording as each of its cameras saw it. With one camera a view is called like its recording."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from edream.core.errors import unknown_name

ALL = "all"


def chosen_cameras(there: tuple[str, ...], wanted: str | tuple[str, ...] | None) -> tuple[str, ...]:
    """The cameras that are meant: those named, every one for "all", or the first there is.

    Raises:
        EdreamError: one does not exist.
    """
    if wanted == ALL:
        return there
    names = there[:1] if wanted is None else (wanted,) if isinstance(wanted, str) else tuple(dict.fromkeys(wanted))
    for name in names:
        if name not in there:
            raise unknown_name("camera", name, there)
    return names


def view_name(recording: str, camera: str, cameras: Iterable[str]) -> str:
    """What a view is called: like the recording where there is one camera, else RECORDING.CAMERA."""
    return recording if len(list(cameras)) == 1 else f"{recording}.{camera}"


def view_of(rendered: Mapping[str, Any], name: str) -> tuple[str, str]:
    """Recording and camera of a view.

    Args:
        rendered: the summary of the stage `render`.
    """
    recording, camera = rendered.get("views", {}).get(name, (name, rendered["camera"]))
    return recording, camera


def plate_file(camera: str, cameras: Sequence[str]) -> str:
    """Where the plate of a camera lies; that of the first is `plate.png`."""
    return "plate.png" if camera == cameras[0] else f"plates/{cameras.index(camera)}.png"
