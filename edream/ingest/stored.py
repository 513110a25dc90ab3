"""Episodes of an ingested data set, read from the store."""

from collections.abc import Iterator

from edream.core.episode import Episode
from edream.core.stage import Artifact
from edream.ingest.episode_read import read_episode
from edream.ingest.index import INDEX, IndexRow, read_index


def stored_index(ingested: Artifact) -> list[IndexRow]:
    """The rows of the index of what `ingest` made.

    Raises:
        EdreamError: it is corrupt.
    """
    return read_index(ingested.path(f"episodes/{INDEX}").parent)


def stored_episodes(ingested: Artifact) -> Iterator[Episode]:
    """Every episode of what `ingest` made, one at a time, in the order of the recordings.

    Raises:
        EdreamError: a file is corrupt.
    """
    for row in stored_index(ingested):
        yield read_episode(ingested.path(f"episodes/{row.file}"))
