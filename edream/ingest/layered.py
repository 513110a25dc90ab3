"""Episodes with further images beside the camera's own (renderings, masks, conditions): one MCAP file each and an index."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8

from edream.core.episode import Episode, Video
from edream.core.stage import Artifact, Bundle
from edream.ingest.episode_file import write_episode
from edream.ingest.episode_read import read_episode
from edream.ingest.index import INDEX, IndexRow, file_name, index_row, index_table, read_index

FILE, ABOUT = "episode.mcap", "about.json"
Images = UInt8[np.ndarray, "T H W 3"]


def layer(times: Float[np.ndarray, "T"], images: Images) -> Video:
    """Images held in memory as a video; grey ones become three equal channels."""
    whole = np.repeat(images[..., None], 3, axis=3) if images.ndim == 3 else images
    return Video(np.asarray(times), whole.shape[1], whole.shape[2], lambda: iter(whole))


def layered_shard(episode: Episode, layers: Mapping[str, Video], folder: Path, about: Mapping[str, Any]) -> Bundle:
    """A shard with one episode whose videos are `layers`.

    Args:
        folder: empty; the file is written there.
        about: what else is known of it, as JSON can say it.
    """
    path = folder / FILE
    kept = replace(episode, videos=layers)
    write_episode(kept, path, provenance={"made by": "edream"}, images="png")
    return {FILE: path, ABOUT: {"row": index_row(kept, path), "about": about}}


def layered_bundle(shards: Iterable[Artifact]) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """The folder `episodes/` with its index, and what each shard said about itself."""
    bundle: dict[str, Any] = {}
    rows: list[IndexRow] = []
    told, taken = [], set()
    for shard in shards:
        about = shard[ABOUT]
        row = IndexRow(**(about["row"] | {"file": file_name(about["row"]["name"], taken)}))
        taken.add(row.file)
        bundle[f"episodes/{row.file}"] = shard.path(FILE)
        rows.append(row)
        told.append(about["about"])
    return bundle | {f"episodes/{INDEX}": index_table(rows)}, told


def layered_episodes(artifact: Artifact) -> Iterator[Episode]:
    """Every episode of such an artifact, in order.

    Raises:
        EdreamError: a file is corrupt.
    """
    for row in read_index(artifact.path(f"episodes/{INDEX}").parent):
        yield read_episode(artifact.path(f"episodes/{row.file}"))


def images_of(episode: Episode, names: Sequence[str]) -> dict[str, Images]:
    """Layers of an episode, decoded, (T, H, W, 3) each."""
    return {name: np.stack(list(episode.videos[name].frames())) for name in names if name in episode.videos}


def layered_images(artifact: Artifact, names: Sequence[str]) -> Iterator[tuple[str, dict[str, Images]]]:
    """Name and decoded layers of every episode, one at a time."""
    for episode in layered_episodes(artifact):
        yield episode.name, images_of(episode, names)
