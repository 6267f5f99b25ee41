"""What a recording is made of: for each camera a folder of images or a video file."""

import re
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from capture_app.errors import BadInputError
from capture_app.session.checks import check_name, is_name
from capture_app.session.store import IMAGE_SUFFIXES
from capture_app.session.verify import image_size

VIDEO_SUFFIXES = (".mp4", ".mov", ".avi", ".mkv", ".m4v", ".webm", ".mjpg", ".mjpeg", ".mpg", ".mpeg")
JPEG_QUALITY = 95


class Source(ABC):
    """The frames of one camera, counted from 0 in the order they were taken."""

    name: str
    path: Path
    kind: str
    suffix: str
    """Ending of the image files that `frames` gives the bytes of."""

    @property
    @abstractmethod
    def numbers(self) -> Sequence[int]:
        """The recording's own number of each frame: equal numbers of two cameras belong together."""

    @property
    @abstractmethod
    def numbered(self) -> bool:
        """Whether the numbers are the recording's own and not just an order."""

    @abstractmethod
    def frames(self, indices: Sequence[int]) -> Iterator[tuple[int, bytes, tuple[int, int]]]:
        """Index, image file bytes and (width, height) in pixels of the frames asked for, in rising order.

        A video leaves out frames that cannot be decoded. Raises BadInputError for a broken image.
        """


class ImageFolder(Source):
    """A folder of image files, in natural order; their bytes are kept as they are."""

    kind = "images"

    def __init__(self, name: str, path: Path) -> None:
        self.name, self.path = name, path
        self._files = sorted(_images_in(path), key=_natural)
        if not self._files:
            raise BadInputError(f"no images in {path}", hint=f"looked for {', '.join(IMAGE_SUFFIXES)}")
        suffixes = {file.suffix.lower() for file in self._files}
        if len(suffixes) > 1:
            raise BadInputError(
                f"{path} mixes {' and '.join(sorted(suffixes))}", hint="keep one kind of image"
            )
        self.suffix = suffixes.pop()
        found = [re.findall(r"\d+", file.stem) for file in self._files]
        own = [int(digits[-1]) for digits in found if digits]
        self._numbered = len(set(own)) == len(self._files)
        self._numbers = own if self._numbered else list(range(len(self._files)))

    @property
    def numbers(self) -> Sequence[int]:
        """The last number in each file's name, or the order where the names have none."""
        return self._numbers

    @property
    def numbered(self) -> bool:
        """Whether every file name has a number of its own."""
        return self._numbered

    def frames(self, indices: Sequence[int]) -> Iterator[tuple[int, bytes, tuple[int, int]]]:
        """See `Source.frames`."""
        for index in sorted(indices):
            file = self._files[index]
            try:
                data = file.read_bytes()
            except OSError as error:
                raise BadInputError(f"cannot read {file}: {error.strerror}") from error
            size = image_size(data)
            if size is None:
                raise BadInputError(f"{file} is not an image that can be decoded")
            yield index, data, size


class Video(Source):
    """A video file, decoded frame by frame into JPEG (quality 95) or PNG."""

    kind = "video"

    def __init__(self, name: str, path: Path, *, png: bool = False) -> None:
        self.name, self.path = name, path
        self.suffix = ".png" if png else ".jpg"
        capture = self._open()
        import cv2

        self._count = int(capture.get(cv2.CAP_PROP_FRAME_COUNT))
        self.fps = float(capture.get(cv2.CAP_PROP_FPS))
        capture.release()
        if self._count <= 0:
            raise BadInputError(
                f"{path} does not say how many frames it has", hint="re-mux it, or use images"
            )

    @property
    def numbers(self) -> Sequence[int]:
        """0, 1, 2, ...: a video's frames have no other number."""
        return range(self._count)

    @property
    def numbered(self) -> bool:
        """True: the first frames of all videos belong together unless a table says otherwise."""
        return True

    def frames(self, indices: Sequence[int]) -> Iterator[tuple[int, bytes, tuple[int, int]]]:
        """See `Source.frames`."""
        import cv2

        options = [] if self.suffix == ".png" else [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY]
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
                yield index, cv2.imencode(self.suffix, image, options)[1].tobytes(), image.shape[1::-1]
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


def open_sources(paths: Sequence[str], *, png: bool = False) -> list[Source]:
    """The cameras of `NAME=PATH` arguments, or of one folder whose subfolders or videos are cameras.

    Raises BadInputError for what is missing, empty, doubled or badly named.
    """
    sources: list[Source] = []
    for text in paths:
        name, path = split_name(text)
        if not path.exists():
            raise BadInputError(f"nothing at {path}")
        if name:
            sources.append(_source(name, path, png))
        elif path.is_dir():
            sources.extend(_sources_in(path, png))
        else:
            sources.append(_source(path.stem, path, png))
    names = [source.name for source in sources]
    for name in names:
        if names.count(name) > 1:
            raise BadInputError(f"two cameras are called {name}", hint="name them: NAME=PATH")
    if not sources:
        raise BadInputError("nothing to import", hint="give a folder, or NAME=PATH for each camera")
    return sorted(sources, key=lambda source: _natural(Path(source.name)))


def split_name(text: str) -> tuple[str, Path]:
    """`NAME=PATH` taken apart; the name is empty where there is none."""
    name, separator, path = text.partition("=")
    if separator and is_name(name) and not Path(text).exists():
        return name, Path(path)
    return "", Path(text)


def _source(name: str, path: Path, png: bool) -> Source:
    check_name(name, "camera")
    return ImageFolder(name, path) if path.is_dir() else Video(name, path, png=png)


def _sources_in(folder: Path, png: bool) -> list[Source]:
    videos = [path for path in folder.iterdir() if path.suffix.lower() in VIDEO_SUFFIXES and path.is_file()]
    folders = [path for path in folder.iterdir() if path.is_dir() and _images_in(path)]
    if not videos and not folders:
        hint = "it needs a subfolder of images or a video file for each camera"
        if _images_in(folder):
            hint = f"its images are of one camera: cam0={folder}"
        raise BadInputError(f"no cameras in {folder}", hint=hint)
    if videos and folders:
        raise BadInputError(f"{folder} has both videos and folders of images", hint="name them: NAME=PATH")
    named = [(path.stem, path) for path in videos] + [(path.name, path) for path in folders]
    return [_source(name, path, png) for name, path in named]


def _images_in(folder: Path) -> list[Path]:
    return [
        path
        for path in folder.iterdir()
        if path.suffix.lower() in IMAGE_SUFFIXES and path.is_file() and not path.name.startswith(".")
    ]


def _natural(path: Path) -> list[tuple[int, str]]:
    """Sort key that puts 9 before 10."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", path.name)]
