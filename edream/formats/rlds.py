"""RLDS data sets as TFDS stores them: TFRecord files, one episode a record; read without TensorFlow."""

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from edream.core.episode import Recording, Video
from edream.core.errors import EdreamError, unknown_name
from edream.core.format import Format, Malformed, ReadOptions
from edream.ingest import tfrecord
from edream.ingest.border import MAX_CHANNELS, finished, one_line
from edream.ingest.video import EncodedFrames, decode_image, image_kind, image_size

STEPS = "steps/"
STATE, COMMAND = "steps/observation/state", "steps/action"
MAX_FILES = 100_000


class Rlds(Format):
    """States in `steps/observation/state`, commands in `steps/action`, encoded images beside them.

    What these columns mean differs between data sets (BridgeData stores end-effector poses, not joints), so their channels are
    named after the feature and never taken for joints by themselves: map them by name or order, or take the video alone with
    `ingest.mapping.by=none`. There is no clock: `ingest.fps` is needed (BridgeData 5). TFDS shuffles episodes on disk, so a
    recording's name is a hash of its content, and a second copy of an episode is named and left out.
    Source: github.com/google-research/rlds; tensorflow.org/datasets, TFRecord and tf.train.Example.
    """

    name = "rlds"
    summary = "TFRecord files of tf.train.Example with steps/... features (RLDS, Open X-Embodiment)"

    def recognise(self, path: Path) -> str | None:
        for file in _files(path):
            try:
                first = next(tfrecord.records(file), None)
                if first is not None and any(key.startswith(STEPS) for key in tfrecord.example(first[1])):
                    return f"{file.name} holds tf.train.Example records with steps/... features"
            except (EdreamError, ValueError):
                continue
        return None

    def recordings(self, path: Path, options: ReadOptions) -> Iterator[Recording | Malformed]:
        if options.fps is None:
            raise EdreamError(f"{path} carries no clock (RLDS). Give its rate as ingest.fps=RATE [Hz]; BridgeData has 5.")
        found, damaged = _index(path)
        for place in found:
            try:
                yield finished(_read(place, options), options)
            except (EdreamError, ValueError) as error:
                yield Malformed(place.name, f"{place.file}, record {place.number}: {one_line(error)}")
        yield from damaged


@dataclass(frozen=True)
class _Place:
    """Where one episode lies."""

    name: str
    file: Path
    number: int
    offset: int


@dataclass(frozen=True)
class _StepImages:
    """Encoded images of one camera of one episode."""

    file: Path
    offset: int
    key: str

    def __call__(self) -> Iterator[bytes]:
        images = tfrecord.example(tfrecord.record_at(self.file, self.offset))[self.key]
        yield from (image for image in images if isinstance(image, bytes))


def _files(path: Path) -> list[Path]:
    if path.is_file():
        return [path] if tfrecord.is_tfrecord(path) else []
    root, found = path.resolve(), []
    for count, file in enumerate(path.rglob("*") if path.is_dir() else ()):
        if count > MAX_FILES:
            raise EdreamError(f"{path} holds more than {MAX_FILES} files; point at the folder of the recordings.")
        named = ".tfrecord" in file.name
        if file.is_file() and (named or tfrecord.is_tfrecord(file)) and file.resolve().is_relative_to(root):
            found.append(file)
    return sorted(found)


def _index(path: Path) -> tuple[list[_Place], list[Malformed]]:
    """Every episode in the order of its name, and what is damaged or stands twice."""
    places: dict[str, _Place] = {}
    damaged: list[Malformed] = []
    for file in _files(path):
        number = 0
        try:
            for number, (offset, data) in enumerate(tfrecord.records(file)):
                name = f"episode_{hashlib.sha256(data).hexdigest()[:12]}"
                if name in places:
                    first = places[name]
                    reason = (
                        f"{file}, record {number}: it is the same episode as record {first.number} of "
                        f"{first.file.name}; only one is used."
                    )
                    damaged.append(Malformed(name, reason))
                else:
                    places[name] = _Place(name, file, number, offset)
        except EdreamError as error:
            damaged.append(Malformed(f"{file.name}[{number}]", str(error)))
    return sorted(places.values(), key=lambda place: place.name), damaged


def _read(place: _Place, options: ReadOptions) -> Recording:
    features = tfrecord.example(tfrecord.record_at(place.file, place.offset))
    rows = max(
        (len(value) for key, value in features.items() if key in ("steps/is_first", "steps/reward", "steps/is_last")), default=0
    )
    if rows < 2:
        raise EdreamError(f"it has {rows} steps (by steps/is_first); expected at least 2.")
    position, channels = _table(features, options.position or (STATE,), rows)
    command, command_channels = _table(features, options.command or (COMMAND,), rows)
    times = np.arange(rows) / float(options.fps or 1.0)
    videos, absent = _videos(place, features, times, options)
    language = features.get("steps/language_instruction")
    notes = {"task": language[0].decode("utf-8", "replace")} if isinstance(language, list) and language else {}
    return Recording(
        name=place.name,
        times=times,
        channels=channels,
        position=position,
        command_times=times,
        command_channels=command_channels,
        command=command,
        videos=videos,
        notes=notes | {"source": f"{place.file.name}[{place.number}]"} | ({"blank_cameras": ", ".join(absent)} if absent else {}),
    )


def _table(features: dict[str, tfrecord.Feature], keys: tuple[str, ...], rows: int) -> tuple[np.ndarray, tuple[str, ...]]:
    columns, names = [], []
    for key in keys:
        value = features.get(key, features.get(STEPS + key))
        if not isinstance(value, np.ndarray):
            raise unknown_name("numeric feature", key, [name for name, one in features.items() if isinstance(one, np.ndarray)])
        width, rest = divmod(len(value), rows)
        if rest or not 0 < width <= MAX_CHANNELS:
            raise EdreamError(f"feature {key!r} has {len(value)} numbers in {rows} steps; expected as many in each.")
        with np.errstate(invalid="ignore"):  # a signalling NaN is named later, like any other
            columns.append(value.reshape(rows, width).astype(np.float64))
        names += [f"{key.removeprefix(STEPS)}[{column}]" for column in range(width)]
    return np.concatenate(columns, axis=1), tuple(names)


def _videos(
    place: _Place, features: dict[str, tfrecord.Feature], times: np.ndarray, options: ReadOptions
) -> tuple[dict[str, Video], list[str]]:
    videos, absent = {}, []
    for key, images in sorted(features.items()):
        if not key.startswith("steps/observation/") or not isinstance(images, list) or not images or not image_kind(images[0]):
            continue
        camera, what = key.removeprefix("steps/observation/"), f"{place.file}, record {place.number}, {key}"
        if len(images) != len(times):
            raise EdreamError(f"camera {camera!r} has {len(images)} images in {len(times)} steps.")
        height, width = image_size(images[0], what)
        # a camera that an episode lacks is stored as one blank image over and over
        if len(set(images)) == 1 and not np.ptp(decode_image(images[0], what)):
            absent.append(camera)
            continue
        frames = EncodedFrames(_StepImages(place.file, place.offset, key), what, options.colour == "bgr")
        videos[camera] = Video(times, height, width, frames)
    return videos, absent


ENTRY = Rlds()
