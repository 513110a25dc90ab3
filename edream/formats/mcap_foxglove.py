"""MCAP recordings with Foxglove's JointStates, as protobuf or JSON."""

from collections.abc import Iterator
from pathlib import Path

from edream.core.episode import Recording
from edream.core.errors import EdreamError
from edream.core.format import Format, Malformed, ReadOptions
from edream.ingest import mcap_file
from edream.ingest.border import finished
from edream.ingest.episode_file import PROFILE
from edream.ingest.foxglove import JOINTS, read_signals
from edream.ingest.signals import assemble


class McapFoxglove(Format):
    """Joint states on a measured and a commanded topic, each on its own clock.

    Source: docs.foxglove.dev, schema JointStates (protobuf foxglove.JointStates and its JSON form).
    """

    name = "mcap_foxglove"
    summary = "MCAP files with foxglove.JointStates messages (protobuf or JSON)"

    def recognise(self, path: Path) -> str | None:
        for file in mcap_file.candidates(path):
            topics = mcap_file.peek(file)
            if topics is None or topics.profile == PROFILE:
                continue
            if any(schema in JOINTS and encoding in ("protobuf", "json") for _, encoding, schema in topics.channels):
                return f"{file.name} is an MCAP file with foxglove.JointStates"
        return None

    def recordings(self, path: Path, options: ReadOptions) -> Iterator[Recording | Malformed]:
        files = mcap_file.candidates(path)
        for name, file in zip(mcap_file.recording_names(path, files), files, strict=True):
            try:
                yield finished(assemble(name, read_signals(file), options), options)
            except EdreamError as error:
                yield Malformed(name, str(error) if str(file) in str(error) else f"{file}: {error}")


ENTRY = McapFoxglove()
