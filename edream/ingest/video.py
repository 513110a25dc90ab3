"""Images of one camera, read when asked for: video files, encoded images, raw images."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import av
import cv2
import numpy as np
from av.error import FFmpegError
from jaxtyping import UInt8

from edream.core.errors import EdreamError, unknown_name
from edream.ingest.border import MAX_PIXELS, check_file, one_line

CONTAINER_MARKS = (b"\xff\xd8\xff", b"\x89PNG\r\n\x1a\n")


def image_kind(data: bytes) -> str | None:
    """ "jpeg" or "png" by the first bytes, or None."""
    if data.startswith(CONTAINER_MARKS[0]):
        return "jpeg"
    return "png" if data.startswith(CONTAINER_MARKS[1]) else None


def image_size(data: bytes, what: str) -> tuple[int, int]:
    """Height and width that an encoded image declares [pixel], read from its header alone.

    Raises:
        EdreamError: it is neither JPEG nor PNG, or declares more pixels than are held.
    """
    kind = image_kind(data)
    height = width = 0
    if kind == "png" and len(data) >= 24:
        width, height = int.from_bytes(data[16:20], "big"), int.from_bytes(data[20:24], "big")
    elif kind == "jpeg":
        height, width = _jpeg_size(data)
    if not (height > 0 and width > 0 and height * width <= MAX_PIXELS):
        raise EdreamError(f"{what} is no JPEG or PNG of 1 to {MAX_PIXELS} pixels (it declares {height} x {width}).")
    return height, width


def _jpeg_size(data: bytes) -> tuple[int, int]:
    at = 2
    while at + 9 <= len(data) and data[at] == 0xFF:
        marker = data[at + 1]
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            return int.from_bytes(data[at + 5 : at + 7], "big"), int.from_bytes(data[at + 7 : at + 9], "big")
        at += 1 if marker == 0xFF else 2 + int.from_bytes(data[at + 2 : at + 4], "big")
    return 0, 0


def decode_image(data: bytes, what: str, swap: bool = False) -> UInt8[np.ndarray, "H W 3"]:
    """A JPEG or PNG as RGB.

    Args:
        data: the encoded image; bytes after its end do no harm.
        what: how messages name it.
        swap: the recorder encoded BGR pixels as if they were RGB; change them back.

    Raises:
        EdreamError: it cannot be decoded.
    """
    image_size(data, what)
    try:
        # IGNORE_ORIENTATION: the picture as recorded, not as an EXIF tag would turn it
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    except cv2.error as error:
        raise EdreamError(f"{what} cannot be decoded: {one_line(error)}.") from error
    if image is None:
        raise EdreamError(f"{what} cannot be decoded; its bytes are damaged or cut short.")
    return image if swap else np.ascontiguousarray(image[:, :, ::-1])


def encode_image(image: UInt8[np.ndarray, "H W 3"], kind: str) -> bytes:
    """An RGB image as "png" (lossless) or "jpeg" (quality 95); the same bytes for the same pixels.

    Raises:
        EdreamError: there is no such kind.
    """
    options = {"png": [cv2.IMWRITE_PNG_COMPRESSION, 1], "jpeg": [cv2.IMWRITE_JPEG_QUALITY, 95]}
    if kind not in options:
        raise unknown_name("image encoding (ingest.images)", kind, options)
    _, data = cv2.imencode(f".{kind}", np.ascontiguousarray(image[:, :, ::-1]), options[kind])
    return data.tobytes()


@dataclass(frozen=True, eq=False)
class EncodedFrames:
    """Frames kept as the JPEG or PNG bytes of the recorder, so that they can be passed on untouched.

    Attributes:
        encoded: opens the stream of encoded images anew.
        what: how messages name them.
        swap: see `decode_image`.
    """

    encoded: Callable[[], Iterator[bytes]]
    what: str
    swap: bool = False

    def __call__(self) -> Iterator[UInt8[np.ndarray, "H W 3"]]:
        for row, data in enumerate(self.encoded()):
            yield decode_image(data, f"{self.what}, image {row}", self.swap)


@dataclass(frozen=True)
class VideoSegment:
    """Frames of one episode inside a video file.

    Attributes:
        file: the video file.
        start: time of its first frame in the file [s].
        count: number of frames.
        fps: nominal rate, for the tolerance of the start [Hz].
    """

    file: Path
    start: float
    count: int
    fps: float

    def __call__(self) -> Iterator[UInt8[np.ndarray, "H W 3"]]:
        found = 0
        try:
            with av.open(str(self.file)) as container:
                stream = container.streams.video[0]
                stream.thread_type = "SLICE"
                first = self.start - 0.5 / self.fps
                if self.start > 0 and stream.time_base:
                    container.seek(max(0, int(first / stream.time_base)), stream=stream, backward=True)
                for frame in container.decode(stream):
                    if found == self.count:
                        return
                    if frame.time is not None and frame.time < first:
                        continue
                    found += 1
                    yield frame.to_ndarray(format="rgb24")
        except (FFmpegError, OSError, ValueError) as error:
            raise EdreamError(f"Video {self.file} is damaged after {found} of {self.count} frames: {one_line(error)}.") from error
        if found < self.count:
            raise EdreamError(f"Video {self.file} ends after {found} frames from {self.start:.3f} s on; expected {self.count}.")


@dataclass(frozen=True)
class VideoHeader:
    """What a video file declares: size [pixel] and length [s]."""

    height: int
    width: int
    duration: float | None


def read_header(file: Path) -> VideoHeader:
    """Size and length of a video file, without decoding it.

    Raises:
        EdreamError: see `check_file`; or it is no video, or its images are too large.
    """
    check_file(file)
    try:
        with av.open(str(file)) as container:
            if not container.streams.video:
                raise EdreamError(f"{file} holds no video stream.")
            stream = container.streams.video[0]
            height, width = stream.height, stream.width
            duration = float(stream.duration * stream.time_base) if stream.duration and stream.time_base else None
    except (FFmpegError, OSError, ValueError, LookupError) as error:
        raise EdreamError(f"Video {file} cannot be opened: {one_line(error)}.") from error
    if not (height > 0 and width > 0 and height * width <= MAX_PIXELS):
        raise EdreamError(f"Video {file} declares images of {height} x {width} pixels; expected 1 to {MAX_PIXELS} pixels.")
    return VideoHeader(height, width, duration)
