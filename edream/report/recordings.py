"""What was noticed in the recordings, as part of any report."""

from collections.abc import Mapping
from typing import Any

from edream.report.page import picture

SHOWN = 4  # cameras


def about_recordings(ingested: Mapping[str, Any]) -> dict[str, Any]:
    """Sentence, findings, malformed recordings, and a preview of each camera's colours."""
    summary = ingested["summary.json"]
    names = sorted(name for name in ingested if name.startswith("preview/"))[:SHOWN]
    caption = "First image as read, and with red and blue exchanged: where the second looks right, set ingest.colour."
    return {
        "sentence": summary["sentence"],
        "noticed": summary["noticed"],
        "malformed": summary["malformed"],
        "previews": [
            picture(f"preview-{i}", f"camera {name.removeprefix('preview/').removesuffix('.png')}", caption, ingested[name])
            for i, name in enumerate(names)
        ],
    }
