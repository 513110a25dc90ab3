"""Episodes that edream wrote: MCAP files of profile "edream", one episode each."""

from collections.abc import Iterator
from pathlib import Path

from edream.core.episode import Recording
from edream.core.errors import EdreamError
from edream.core.format import Format, Malformed, ReadOptions
from edream.ingest import mcap_file
from edream.ingest.border import finished
from edream.ingest.episode_file import PROFILE
from edream.ingest.episode_read import read_recording


class EdreamMcap(Format):
    """What `edream ingest` makes, taken as recordings again; values come back exactly."""

    name = "edream_mcap"
    summary = "MCAP files that edream ingest wrote (profile edream)"

    def recognise(self, path: Path) -> str | None:
        for file in mcap_file.candidates(path):
            topics = mcap_file.peek(file)
            if topics and topics.profile == PROFILE:
                return f"{file.name} is an MCAP file of profile {PROFILE}"
        return None

    def recordings(self, path: Path, options: ReadOptions) -> Iterator[Recording | Malformed]:
        files = mcap_file.candidates(path)
        for name, file in zip(mcap_file.recording_names(path, files), files, strict=True):
            try:
                yield finished(read_recording(file), options)
            except EdreamError as error:
                yield Malformed(name, str(error))


ENTRY = EdreamMcap()
