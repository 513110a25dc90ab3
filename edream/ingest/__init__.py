"""From what users bring to episodes on a robot's joints: borders, mapping, findings and episode files.

`recordings.ingest_recordings` is the entry point; the formats themselves are one file each in `edream/formats/`.
"""
