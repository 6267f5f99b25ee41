"""The cameras of a recording: for each a folder of images or a video file.

What a program's folder holds, in one form for all programs.
"""

import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from capture_app.errors import BadInputError
from capture_app.names import natural_order
from capture_app.session.exchange import ExportRecord
from capture_app.session.format.manifest import IMAGE_SUFFIXES
from capture_app.session.importers.calibrations.views import Views
from capture_app.session.importers.embedded_times import video_pictures, video_times_ns
from capture_app.session.importers.frame_matching import TimedFrame, Timeline
from capture_app.session.reading.decoding import decode_image, image_size
from capture_app.session.reading.file_headers import read_exif

UNCOUNTED_SUFFIXES = (".mjpg", ".mjpeg", ".mpg", ".mpeg", ".h264", ".264", ".mts", ".m2ts", ".ts")
"""Videos that do not say how many frames they have."""
VIDEO_SUFFIXES = (".mp4", ".mov", ".avi", ".mkv", ".m4v", ".webm", *UNCOUNTED_SUFFIXES)
JPEG_QUALITY = 95
TURNED_QUALITY = 98
"""Of pictures that were JPEGs before."""
JPEG_BEGIN = b"\xff\xd8"


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


class ImageFolder(Source):
    """A folder of image files, in natural order, or one image.

    Their bytes are kept as they are, but for those that EXIF says to turn.
    """

    kind = "images"

    def __init__(self, name: str, path: Path) -> None:
        self.name, self.path = name, path
        found = [path] if path.is_file() else images_in(path)
        self.files = sorted(found, key=lambda file: natural_order(file.name))
        """In the order of the frames."""
        if not self.files:
            raise BadInputError(f"no images in {path}", hint=f"looked for {', '.join(IMAGE_SUFFIXES)}")
        suffixes = {file.suffix.lower() for file in self.files}
        if len(suffixes) > 1:
            raise BadInputError(
                f"{path} mixes {' and '.join(sorted(suffixes))}", hint="keep one kind of image"
            )
        self.suffix = suffixes.pop()
        in_names = [re.findall(r"\d+", file.stem) for file in self.files]
        # The number of a single image is its camera's as often as its time's.
        last = [int(digits[-1]) for digits in in_names if digits and path.is_dir()]
        self.numbered = len(set(last)) == len(self.files)
        self.numbers = last if self.numbered else range(len(self.files))

    def frames(self, indices: Sequence[int]) -> Iterator[tuple[int, bytes, tuple[int, int]]]:
        """See `Source.frames`."""
        return read_images(self.files, indices)


def read_images(
    files: Sequence[Path], indices: Sequence[int], read: Callable[[Path], bytes] = Path.read_bytes
) -> Iterator[tuple[int, bytes, tuple[int, int]]]:
    """Yield what `Source.frames` does from a file an index; `read` makes an image's bytes of a file.

    Raises BadInputError for a file that cannot be read or decoded.
    """
    for index in sorted(indices):
        file = files[index]
        try:
            data = read(file)
        except OSError as error:
            raise BadInputError(f"cannot read {file}: {error.strerror}") from error
        data = upright(data)
        size = image_size(data)
        if size is None:
            raise BadInputError(f"{file} is not an image that can be decoded")
        yield index, data, size


def upright(data: bytes) -> bytes:
    """Return an image file's bytes as they are, or encoded anew where its EXIF says that it is to be turned.

    Some programs turn such pictures and some do not: in a session all see the same.
    """
    try:
        turned = read_exif(data).orientation in range(2, 9) if data[:2] == JPEG_BEGIN else False
    except ValueError:
        return data
    if not turned:
        return data
    image = decode_image(data, upright=True)
    if image is None:
        return data
    import cv2

    return bytes(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, TURNED_QUALITY])[1].tobytes())


class Video(Source):
    """A video file, decoded frame by frame into JPEG (quality 95) or PNG."""

    kind = "video"
    numbered = True
    """The first frames of all videos belong together unless a table says otherwise."""

    def __init__(self, name: str, path: Path, *, png: bool = False) -> None:
        self.name, self.path = name, path
        self.suffix = ".png" if png else ".jpg"
        capture = self._open()
        import cv2

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
        """Read when each frame is shown, in ns, and take frames by that; see `video_times_ns`."""
        self._times_ns = video_times_ns(self.path)
        self.numbers = range(len(self._times_ns))
        return self._times_ns

    def frames(self, indices: Sequence[int]) -> Iterator[tuple[int, bytes, tuple[int, int]]]:
        """See `Source.frames`."""
        import cv2

        options = [] if self.suffix == ".png" else [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY]
        for index, image in self._read_by_time(indices) if self._times_ns else self._read(indices):
            yield index, cv2.imencode(self.suffix, image, options)[1].tobytes(), image.shape[1::-1]

    def _read_by_time(self, indices: Sequence[int]) -> Iterator[tuple[int, Any]]:
        """The frames (BGR) that are shown at the times of these indices; what does not decode is left out."""
        wanted = {self._times_ns[index]: index for index in indices}
        return ((wanted[at_ns], image) for at_ns, image in video_pictures(self.path, wanted))

    def _read(self, indices: Sequence[int]) -> Iterator[tuple[int, Any]]:
        """The frames (BGR) of these indices by their order, up to the first that does not decode."""
        capture = self._open()
        try:
            position = 0
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
        import cv2

        before = cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
        try:
            capture = cv2.VideoCapture(str(self.path))
        finally:
            cv2.utils.logging.setLogLevel(before)
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

    program: str
    path: Path
    """Where the cameras are."""
    sources: tuple[Source, ...]
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
    """Of our own exports: the session that it was made of."""
    remark: str = ""
    """What the user should know."""
