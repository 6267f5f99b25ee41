"""The cameras of a recording, each of images or a video file, and what a program's folder holds of them."""

import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from capture_app.common.errors import BadInputError, reading
from capture_app.common.names import natural_order
from capture_app.session.format.export_record import ExportRecord
from capture_app.session.format.manifest import IMAGE_SUFFIXES
from capture_app.session.importing.embedded_times import video_pictures, video_times_ns
from capture_app.session.importing.frame_matching import TimedFrame, Timeline
from capture_app.session.importing.views import Views
from capture_app.session.reading.decoding import decode_image, encode_image, image_size, open_capture
from capture_app.session.reading.file_headers import read_exif

UNCOUNTED_SUFFIXES = (".mjpg", ".mjpeg", ".mpg", ".mpeg", ".h264", ".264", ".mts", ".m2ts", ".ts")
"""Videos that do not say how many frames they have."""
VIDEO_SUFFIXES = (".mp4", ".mov", ".avi", ".mkv", ".m4v", ".webm", *UNCOUNTED_SUFFIXES)
TURNED_QUALITY = 98
"""The quality of pictures that were JPEGs before."""
JPEG_BEGIN = b"\xff\xd8"
FOLDER = "images"
"""The kind of a plain folder of images."""


class Source(ABC):
    """The frames of one camera, counted from 0 in the order they were taken."""

    name: str
    path: Path
    kind: str
    remark: str = ""
    """A remark for the user on what was assumed."""
    suffix: str
    """Ending of the image files that `frames` gives the bytes of."""
    numbers: Sequence[int]
    """The recording's own number of each frame: equal numbers of two cameras belong together."""
    numbered: bool
    """Whether the numbers are the recording's own and not just an order."""

    def embedded_times(self) -> Sequence[TimedFrame] | None:
        """When its frames were taken by the rig's common clock, where its files tell that; else None."""
        return None

    @abstractmethod
    def frames(self, indices: Sequence[int]) -> Iterator[tuple[int, bytes, tuple[int, int]]]:
        """Index, image file bytes and (width, height) in pixels of the frames asked for, in ascending order.

        A video leaves out frames that cannot be decoded. Raises BadInputError for a broken image.
        """


class Images(Source):
    """Image files, one a frame, in the order that they are given in."""

    def __init__(
        self,
        name: str,
        path: Path,
        files: Sequence[Path],
        kind: str,
        *,
        read: Callable[[Path], bytes] = Path.read_bytes,
        times: Sequence[TimedFrame] | None = None,
    ) -> None:
        """`read` gives the bytes of the image that a file has; `times` are by the rig's clock."""
        self.name, self.path, self.files, self.kind = name, path, files, kind
        self.numbers, self.numbered = range(len(files)), times is None
        self.suffix = files[0].suffix.lower()
        self._read, self._times = read, times

    def embedded_times(self) -> Sequence[TimedFrame] | None:
        """See `Source.embedded_times`."""
        return self._times

    def frames(self, indices: Sequence[int]) -> Iterator[tuple[int, bytes, tuple[int, int]]]:
        """See `Source.frames`; raises BadInputError for a file that cannot be read or decoded too."""
        for index in sorted(indices):
            with reading(self.files[index]):
                data = self._read(self.files[index])
            size = image_size(data)
            if size is None:
                raise BadInputError(f"{self.files[index]} is not an image that can be decoded")
            yield index, data, size


def image_folder(name: str, path: Path) -> Images:
    """A folder of image files, in natural order, or one image; those that EXIF says to turn are turned.

    Raises BadInputError where there are none, or several kinds of them.
    """
    found = [path] if path.is_file() else images_in(path)
    files = sorted(found, key=lambda file: natural_order(file.name))
    if not files:
        raise BadInputError(f"no images in {path}", hint=f"looked for {', '.join(IMAGE_SUFFIXES)}")
    suffixes = {file.suffix.lower() for file in files}
    if len(suffixes) > 1:
        raise BadInputError(f"{path} mixes {' and '.join(sorted(suffixes))}", hint="keep one kind of image")
    source = Images(name, path, files, FOLDER, read=lambda file: upright(file.read_bytes()))
    in_names = [re.findall(r"\d+", file.stem) for file in files]
    # The number of a single image is its camera's as often as its time's.
    last = [int(digits[-1]) for digits in in_names if digits and path.is_dir()]
    source.numbered = len(set(last)) == len(files)
    if source.numbered:
        source.numbers = last
    return source


def upright(data: bytes) -> bytes:
    """Return an image file's bytes as they are, or encoded anew where its EXIF says that it is to be turned.

    Some programs turn such pictures and some do not: in a session all see the same.
    """
    turned = False
    with suppress(ValueError):
        turned = data[:2] == JPEG_BEGIN and read_exif(data).orientation in range(2, 9)
    image = decode_image(data, upright=True) if turned else None
    return data if image is None else encode_image(image, quality=TURNED_QUALITY)


class Video(Source):
    """A video file, decoded frame by frame into JPEG (quality 95) or PNG."""

    kind = "video"
    numbered = True
    """The first frames of all videos belong together unless a table says otherwise."""

    def __init__(self, name: str, path: Path, *, png: bool = False) -> None:
        self.name, self.path = name, path
        self.suffix = ".png" if png else ".jpg"
        import cv2

        capture = self._open()
        self._times_ns: Sequence[int] = ()
        count = int(capture.get(cv2.CAP_PROP_FRAME_COUNT))
        if path.suffix.lower() in UNCOUNTED_SUFFIXES:
            count = sum(1 for _ in iter(capture.grab, False))
        self.numbers = range(count)
        self.fps = float(capture.get(cv2.CAP_PROP_FPS))
        capture.release()
        if not self.numbers:
            raise BadInputError(
                f"{path} does not say how many frames it has", hint="re-mux it, or use images"
            )

    def use_embedded_times(self) -> Sequence[int]:
        """Read when each frame is shown, in ns, and take frames by that, if it says; see `video_times_ns`."""
        self._times_ns = video_times_ns(self.path)
        if self._times_ns:
            self.numbers = range(len(self._times_ns))
        return self._times_ns

    def frames(self, indices: Sequence[int]) -> Iterator[tuple[int, bytes, tuple[int, int]]]:
        """See `Source.frames`."""
        # By their times, a frame that does not decode shifts no other.
        wanted = {self._times_ns[index]: index for index in indices} if self._times_ns else {}
        timed = ((wanted[at_ns], image) for at_ns, image in video_pictures(self.path, wanted))
        for index, image in timed if self._times_ns else self._read(indices):
            yield index, encode_image(image, self.suffix), image.shape[1::-1]

    def _read(self, indices: Sequence[int]) -> Iterator[tuple[int, Any]]:
        """The frames (BGR) of these indices by their order, up to the first that does not decode."""
        capture, position = self._open(), 0
        try:
            for index in sorted(indices):
                while position < index and capture.grab():
                    position += 1
                good, image = capture.read()
                position += 1
                if not good:
                    return
                yield index, image
        finally:
            capture.release()

    def _open(self) -> Any:
        capture = open_capture(str(self.path))
        if not capture.isOpened():
            raise BadInputError(f"{self.path} is not a video that can be decoded")
        return capture


def videos_in(folder: Path) -> list[Path]:
    """The videos of a folder, by their names; none where there is no such folder."""
    if not folder.is_dir():
        return []
    return sorted(
        path for path in folder.iterdir() if path.suffix.lower() in VIDEO_SUFFIXES and path.is_file()
    )


def images_in(folder: Path) -> list[Path]:
    """The image files of a folder, in no order."""
    return [
        path
        for path in folder.iterdir()
        if path.suffix.lower() in IMAGE_SUFFIXES and path.is_file() and not path.name.startswith(".")
    ]


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """The cameras in a program's folder, and its times and calibration where it has them."""

    path: Path
    """Where the cameras are."""
    sources: tuple[Source, ...]
    program: str = ""
    """Which program made it, where the importer's name is not enough."""
    timeline: Timeline | None = None
    """The times that the program wrote."""
    timestamps: Path | None = None
    """A table with them."""
    same_frames: bool = False
    """Frames of the same number are of one instant, at the videos' own rate."""
    calibration: Path | None = None
    views: Views | None = None
    """The calibration, where it is in the recording itself."""
    unit: str | None = None
    record: ExportRecord | None = None
    """The session that an export of our own was made of."""
    remark: str = ""
    """What the user should know."""
