"""ALOHA recordings: one HDF5 file an episode, in the variants of ALOHA, Mobile ALOHA and AgileX Cobot Magic."""

import re
from collections.abc import Iterable, Iterator
from pathlib import Path

import h5py
import numpy as np

from edream.core.episode import Recording, Video
from edream.core.errors import EdreamError
from edream.core.format import Format, Malformed, ReadOptions
from edream.ingest import hdf5_file
from edream.ingest.aloha_images import EncodedRows, RawRows
from edream.ingest.border import MAX_PIXELS, finished
from edream.ingest.conditions import write_conditions
from edream.ingest.rows import held_commands, new_folder
from edream.ingest.video import EncodedFrames, image_size

MAX_FILES = 100_000
BASE, DEPTH, CLOCK = "base_action", "observations/images_depth", "timestamps"


class AlohaHdf5(Format):
    """Commands in `/action`, measurements in `/observations/{qpos,qvel,effort}`, images in `/observations/images/CAMERA`.

    The files carry no clock, so the rate must be given (`ingest.fps`; ALOHA 50, AgileX 30) unless they have `/timestamps` [s],
    as those that edream writes do: these are taken as they are, whatever the rate. Images are raw where they have four
    dimensions and JPEG where they have two, whatever the attribute `compress` says, for it may be absent. Two official readers
    disagree on whether raw images are RGB or BGR: see `ingest.colour`. The original loader takes real robots' actions one row
    early: see `ingest.command_shift`. A mobile base's `/base_action` is kept as a signal; depth images are named and left
    alone.
    Source: github.com/tonyzhaozh/act, github.com/MarkFzp/act-plus-plus, github.com/agilexrobotics/cobot_magic.
    """

    name = "aloha_hdf5"
    summary = "HDF5 files with /action and /observations/qpos"

    def recognise(self, path: Path) -> str | None:
        for file in _files(path):
            try:
                with hdf5_file.opened(file) as opened:
                    if {"action", "observations"} <= set(opened.keys()):
                        return f"{file.name} is an HDF5 file with /action and /observations"
            except EdreamError:
                # a damaged file is named when it is read; another one may still tell the format
                continue
        return None

    def recordings(self, path: Path, options: ReadOptions) -> Iterator[Recording | Malformed]:
        files = _files(path)
        stems = [file.stem for file in files]
        unique = len(set(stems)) == len(stems)
        for file in files:
            name = file.stem if unique else file.relative_to(path).with_suffix("").as_posix()
            try:
                yield finished(_read(file, name, options), options)
            except _NoClockError as error:
                raise EdreamError(str(error)) from error
            except EdreamError as error:
                yield Malformed(name, str(error))

    def write(self, recordings: Iterable[Recording], path: Path) -> None:
        new_folder(path)
        conditions = {}
        for number, recording in enumerate(recordings):
            name = f"episode_{number}"
            _write(recording, path / f"{name}.hdf5")
            conditions[name] = recording.conditions
        write_conditions(conditions, path)


class _NoClockError(EdreamError):
    """The one thing that is wrong with all files alike."""


def _files(path: Path) -> list[Path]:
    if path.is_file():
        return [path] if hdf5_file.is_hdf5(path) or path.suffix in (".hdf5", ".h5") else []
    root, found = path.resolve(), []
    for count, file in enumerate(path.rglob("*") if path.is_dir() else ()):
        if count > MAX_FILES:
            raise EdreamError(f"{path} holds more than {MAX_FILES} files; point at the folder of the recordings.")
        if file.is_file() and (file.suffix in (".hdf5", ".h5") or hdf5_file.is_hdf5(file)) and file.resolve().is_relative_to(root):
            found.append(file)
    return sorted(found, key=lambda file: [int(part) if part.isdigit() else part for part in re.split(r"(\d+)", str(file))])


def _read(file: Path, name: str, options: ReadOptions) -> Recording:
    with hdf5_file.opened(file) as opened:
        position = hdf5_file.table(opened, "observations/qpos")
        command = hdf5_file.table(opened, "action")
        if position is None or command is None:
            missing = "/observations/qpos" if position is None else "/action"
            raise EdreamError(f"{file} has no data set {missing}; expected an ALOHA recording.")
        if len(position) != len(command):
            raise EdreamError(f"{file}: /action has {len(command)} rows and /observations/qpos {len(position)}; expected as many.")
        times = _times(opened, file, len(position), options)
        return Recording(
            name=name,
            times=times,
            channels=hdf5_file.texts(opened["observations/qpos"].attrs.get("channels")),
            position=position,
            command_times=times,
            command_channels=hdf5_file.texts(opened["action"].attrs.get("channels")),
            command=command,
            velocity=hdf5_file.table(opened, "observations/qvel"),
            effort=hdf5_file.table(opened, "observations/effort"),
            videos=_videos(opened, file, times, options),
            notes=_notes(opened, options),
            signals=_signals(opened, file, len(position)),
        )


def _notes(opened: h5py.File, options: ReadOptions) -> dict[str, str]:
    """Whether it is a simulation's, and what of the file, or of what was asked for, edream does not use."""
    notes = {"simulated": str(bool(opened.attrs["sim"]))} if "sim" in opened.attrs else {}
    depth = hdf5_file.entry(opened, DEPTH)
    left = [f"{DEPTH}/{name}" for name in sorted(depth.keys())] if isinstance(depth, h5py.Group) else []
    if options.fps is not None and CLOCK in opened:
        left.append(f"ingest.fps={options.fps:g} (/{CLOCK} say when each row was recorded)")
    return notes | ({"left_alone": ", ".join(left)} if left else {})


def _signals(opened: h5py.File, file: Path, rows: int) -> dict[str, np.ndarray]:
    """What moves no joint: the base's commands of Mobile ALOHA and AgileX."""
    base = hdf5_file.table(opened, BASE)
    if base is None:
        return {}
    if len(base) != rows:
        raise EdreamError(f"{file}: /{BASE} has {len(base)} rows and /observations/qpos {rows}; expected as many.")
    return {BASE: base}


def _times(opened: h5py.File, file: Path, rows: int, options: ReadOptions) -> np.ndarray:
    stored = hdf5_file.dataset(opened, CLOCK, kinds="f")
    if stored is not None:
        if stored.shape != (rows,):
            raise EdreamError(f"{file}: /{CLOCK} has shape {stored.shape}; expected ({rows},).")
        return np.asarray(stored[()], dtype=np.float64)
    if options.fps is not None:
        return np.arange(rows) / options.fps
    raise _NoClockError(
        f"{file} carries no clock. Give its rate as ingest.fps=RATE [Hz]: 50 for ALOHA and Mobile ALOHA, 30 for AgileX."
    )


def _videos(opened: h5py.File, file: Path, times: np.ndarray, options: ReadOptions) -> dict[str, Video]:
    group = hdf5_file.entry(opened, "observations/images")
    if group is None:
        return {}
    if not isinstance(group, h5py.Group):
        raise EdreamError(f"{file}: /observations/images is no group of cameras.")
    return {name: _video(opened, file, name, times, options) for name in sorted(group.keys())}


def _video(opened: h5py.File, file: Path, camera: str, times: np.ndarray, options: ReadOptions) -> Video:
    name = f"observations/images/{camera}"
    images = hdf5_file.dataset(opened, name, kinds="u")
    if images is None:
        raise EdreamError(f"{file}: /{name} is listed but cannot be opened; expected a data set of images.")
    swap, what, shape = options.colour == "bgr", f"{file}, camera {camera!r}", images.shape
    if images.dtype != np.uint8 or len(shape) not in (2, 4) or shape[0] != len(times):
        raise EdreamError(
            f"{what} holds {images.dtype} of shape {shape}; expected uint8 (rows, height, width, 3) or (rows, bytes), "
            f"{len(times)} rows."
        )
    if len(shape) == 4:
        if shape[3] != 3 or not 0 < shape[1] * shape[2] <= MAX_PIXELS:
            raise EdreamError(
                f"{what} has images of shape {shape[1:]}; expected (height, width, 3) of at most {MAX_PIXELS} pixels."
            )
        return Video(times, shape[1], shape[2], RawRows(file, name, swap))
    if shape[1] > hdf5_file.MAX_CHUNK:
        raise EdreamError(f"{what} declares images of {shape[1]} bytes; expected at most {hdf5_file.MAX_CHUNK}.")
    height, width = image_size(images[0].tobytes(), f"{what}, image 0")
    return Video(times, height, width, EncodedFrames(EncodedRows(file, name), what, swap))


def _write(recording: Recording, file: Path) -> None:
    command = held_commands(recording)
    with h5py.File(file, "w", libver="v110", track_order=True) as out:
        out.attrs["sim"] = False
        out.attrs["compress"] = False
        out.create_dataset("timestamps", data=recording.times)
        out.create_dataset("action", data=command).attrs["channels"] = list(recording.command_channels)
        seen = out.create_group("observations")
        seen.create_dataset("qpos", data=recording.position).attrs["channels"] = list(recording.channels)
        for name, numbers in recording.signals.items():
            out.create_dataset(name, data=numbers)
        for what, array in (("qvel", recording.velocity), ("effort", recording.effort)):
            if array is not None:
                seen.create_dataset(what, data=array)
        for camera, video in recording.videos.items():
            if len(video.times) != len(recording.times):
                raise EdreamError(
                    f"Recording {recording.name!r}: camera {camera!r} has {len(video.times)} images for "
                    f"{len(recording.times)} rows; ALOHA needs one each."
                )
            shape = (len(video.times), video.height, video.width, 3)
            images = out.create_dataset(f"observations/images/{camera}", shape, np.uint8, chunks=(1, *shape[1:]))
            for row, image in enumerate(video.frames()):
                images[row] = image


ENTRY = AlohaHdf5()
