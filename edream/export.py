"""`edream export`: ingested episodes as a data set in another program's format."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from edream import catalog
from edream.core.episode import Recording
from edream.core.errors import EdreamError
from edream.core.format import Format
from edream.core.stage import Artifact
from edream.ingest.episode_read import read_recording
from edream.ingest.stored import stored_index


def export(ingested: Artifact, format: str, out: Path) -> dict[str, Any]:
    """Write what `ingest` made as a new data set.

    Args:
        ingested: the artifact of the stage `ingest`.
        format: a format that can be written, such as "lerobot_v3".
        out: the new folder.

    Returns:
        A summary: data (path), format, episodes, duration_s.

    Raises:
        EdreamError: the format is unknown or read only, `out` exists, or an episode is corrupt.
    """
    if out.exists():
        raise EdreamError(f"There is already something at {out}; --out must name a new folder.")
    rows = stored_index(ingested)

    def recordings() -> Iterator[Recording]:
        for row in rows:
            yield read_recording(ingested.path(f"episodes/{row.file}"))

    out.parent.mkdir(parents=True, exist_ok=True)
    catalog.load("formats", format, Format).write(recordings(), out)
    return {"data": str(out.absolute()), "format": format, "episodes": len(rows), "duration_s": sum(row.duration for row in rows)}
