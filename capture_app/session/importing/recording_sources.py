"""Cameras of a recording, as images or a video file each, and the contents of a program's folder."""

import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from itertools import takewhile
from pathlib import Path

from capture_app.common.errors import BadInputError, NotAvailableError, reading
from capture_app.common.names import IMAGE_SUFFIXES, VIDEO_SUFFIXES, natural_order
from capture_app.common.text import count
from capture_app.session.files.untrusted_files import read_input, rejecting
from capture_app.session.format.export_record import ExportRecord
from capture_app.session.importing.frame_matching import TimedFrame, Timeline
from capture_app.session.importing.video_tracks import (
    DAMAGED,
    describe_video,
    video_pictures,
    video_span,
    video_times_ns,
)
from capture_app.session.importing.views import Views
from capture_app.session.reading.decoding import (
    Exif,
    decode_image,
    decode_turned,
    encode_image,
    image_size,
    read_exif,
)

ARCHIVE_SUFFIXES = (".zip", ".tar", ".gz", ".tgz", ".7z", ".rar")
MAX_DEPTH = 12
"""Maximum folder depth of a search, such as CAMERA/DCIM/100GOPRO."""
Numbers = tuple[int, ...]
"""All numbers in a name, in order."""
_FIRST_CHAPTER = re.compile(r"(?P<kind>G[XH])01(?P<number>\d{4})|GOPR(?P<old>\d{4})")
TOUCHING_S = 2.0
"""Maximum gap between the files of a split recording, s: their dates are whole seconds."""
PART_SLACK_S, PART_SLACK = 0.5, 0.05
"""Maximum difference of the lengths of these files, but the last: s, or relative to the first one's."""
_DATE = re.compile(
    r"((?:19|20)\d{2})[-_.:]?(\d{2})[-_.:]?(\d{2})[-_.T ]?(\d{2})[-_.:h]?(\d{2})[-_.:m]?(\d{2})"
    # One or two digits after a dash are a counter within the second.
    r"(?:[.,]|[-_]?(?=\d{3}))?(\d*)"
)
_OFFSET = re.compile(r"[+-]\d\d:\d\d")
_EPOCH = re.compile(r"(?<!\d)([1-9]\d*)(?:(?:\.|[_-](?=\d{6}(?!\d)|\d{9}(?!\d)))(\d+))?(?!\d)")
_EPOCH_NS = {10: 9, 13: 6, 16: 3, 19: 0}
"""Number of digits of a Unix time, and the power of ten that converts it to ns."""
_OTHER_TIMES = "take the times from elsewhere: --times name, --timestamps CSV or --fps RATE"
TURNED_QUALITY = 98
"""JPEG quality of images encoded a second time after rotation."""
WIDE, SIMILAR = 2.4, 0.5
"""Aspect and correlation of pictures of two views: 0.48 to 0.99 in 20 real pairs, up to 0.43 in 57 others."""
FOLDER = "images"
"""Type name of a plain folder of images."""


class Source(ABC):
    """The frames of one camera, counted from 0 in capture order."""

    name: str
    label: str = ""
    """What its owner calls it, in any script; empty for its name."""
    path: Path
    kind: str
    notes: Sequence[str] = ()
    """What its files hold that the user may not expect."""
    suffix: str
    """Suffix of the image files whose bytes `frames` yields."""
    numbers: Sequence[int]
    """The place of each frame in the recording, from 0."""
    name_numbers: Sequence[Numbers] = ()
    """All numbers in the name of each frame; empty if nothing numbers the frames but their order."""

    def embedded_times(self) -> Sequence[TimedFrame] | None:
        """Return the frames' times by the rig's common clock if its files have them, otherwise None."""
        return None

    @abstractmethod
    def frames(self, indices: Sequence[int]) -> Iterator[tuple[int, bytes, tuple[int, int]]]:
        """Yield index, image file bytes and (width, height) in px of the requested frames, ascending.

        A video skips frames that cannot be decoded. Raises BadInputError for a damaged image.
        """


def labels_of(sources: Sequence[Source]) -> dict[str, str]:
    """Return what their owner calls the cameras, by name."""
    return {source.name: source.label or source.name for source in sources}


class Images(Source):
    """Image files, one for each frame, in the given order."""

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
        """Take image files; `read` returns the image bytes of a file, `times` are by the rig's clock."""
        self.name, self.path, self.files, self.kind = name, path, files, kind
        self.numbers = range(len(files))
        self.suffix = files[0].suffix.lower()
        self._read, self._times = read, times

    def embedded_times(self) -> Sequence[TimedFrame] | None:
        """See `Source.embedded_times`."""
        return self._times

    def read(self, index: int) -> bytes:
        """Return the bytes of a frame's image file, not decoded. Raises BadInputError if it is unreadable."""
        with reading(self.files[index]):
            return self._read(self.files[index])

    def frames(self, indices: Sequence[int]) -> Iterator[tuple[int, bytes, tuple[int, int]]]:
        """See `Source.frames`; also raises BadInputError for a file that cannot be read or decoded."""
        for index in sorted(indices):
            data = self.read(index)
            if (size := image_size(data)) is None:
                raise BadInputError(f"{self.files[index]} is not an image that can be decoded", hint=DAMAGED)
            yield index, data, size


def image_folder(name: str, path: Path, some: Sequence[Path] = ()) -> Images:
    """Open a folder of image files in natural order, `some` of them, or one image, and apply EXIF rotations.

    Raises BadInputError if there are no images, or several types of them.
    """
    files = list(some) or ([path] if path.is_file() else images_in(path))
    files.sort(key=lambda file: natural_order(str(file)))
    if not files:
        raise BadInputError(
            f"no images in {path}", hint=f"name a folder with images of a kind of {', '.join(IMAGE_SUFFIXES)}"
        )
    suffixes = {file.suffix.lower() for file in files}
    if len(suffixes) > 1:
        raise BadInputError(f"{path} mixes {' and '.join(sorted(suffixes))}", hint="keep one kind of image")
    source = Images(name, path, files, FOLDER, read=lambda file: upright(file.read_bytes(), file.suffix))
    # The number in a single image's name may be its camera's or its time's.
    names = [str(file.relative_to(path).with_suffix("")) for file in files] if path.is_dir() else ()
    source.name_numbers = [numbers_in(name) for name in names]
    source.notes = [*_describe_links(files), *_describe_tiff(name, files[0])]
    return source


def _describe_links(files: Sequence[Path]) -> list[str]:
    """Return a note about the files that are links out of their folder, whose targets are read; or none."""
    elsewhere = [
        file for file in files if file.is_symlink() and file.resolve().parent != file.parent.resolve()
    ]
    followed = f"{count(len(elsewhere), 'link')} out of the folder followed"
    return [f"{followed}, such as {file} to {file.resolve()}" for file in elsewhere[:1]]


def _describe_tiff(name: str, file: Path) -> list[str]:
    """Return what a camera's first TIFF has that an import or an export leaves out; none if nothing."""
    if file.suffix.lower() not in (".tif", ".tiff"):
        return []
    import cv2

    image = cv2.imread(str(file), cv2.IMREAD_UNCHANGED) if (pages := cv2.imcount(str(file))) else None
    depth = (
        ""
        if image is None or image.itemsize < 2
        else f"16 bits, of which {int(image.max()).bit_length()} are used"
    )
    says = {
        f"has {pages} pages, of which the first is imported; the others need files of their own": pages > 1,
        f"has {depth}: exports of 8 bits take the upper ones": depth,
    }
    return [f"{name}: {file.name} {say}" for say, holds in says.items() if holds]


def upright(data: bytes, suffix: str) -> bytes:
    """Return an image file's bytes unchanged, or encoded again upright if its EXIF asks for a rotation.

    Some programs apply that rotation and some do not; in a session the pixels are unambiguous.
    """
    image = decode_turned(data)
    return data if image is None else encode_image(image, suffix.lower(), quality=TURNED_QUALITY)


class Half(Source):
    """One of two views side by side in each picture of a camera; a middle column is left out."""

    def __init__(self, whole: Source, name: str, *, right: bool) -> None:
        self.name, self.path, self.kind, self.suffix = name, whole.path, whole.kind, whole.suffix
        self.label = name.replace(whole.name, whole.label or whole.name, 1)
        self.numbers, self.name_numbers = whole.numbers, whole.name_numbers
        self._whole, self._right = whole, right

    def frames(self, indices: Sequence[int]) -> Iterator[tuple[int, bytes, tuple[int, int]]]:
        """See `Source.frames`."""
        for index, data, (width, height) in self._whole.frames(indices):
            half = width // 2
            if (image := decode_image(data, colour=True)) is None:
                raise BadInputError(f"frame {index} of {self.path} cannot be decoded", hint=DAMAGED)
            view = image[:, width - half :] if self._right else image[:, :half]
            yield index, encode_image(view, self.suffix, quality=TURNED_QUALITY), (half, height)


def holds_two_views(source: Source) -> bool:
    """Return whether a camera's first picture is wide, and its right half repeats what the left one shows."""
    import cv2

    for _, data, (width, height) in source.frames([0]):
        image = decode_image(data, colour=True) if width >= WIDE * height else None
        if image is not None:
            small = cv2.resize(image, (128, 48), interpolation=cv2.INTER_AREA)
            found = cv2.matchTemplate(small[:, 64:], small[4:-4, 8:56], cv2.TM_CCOEFF_NORMED)
            return float(found.max()) > SIMILAR
    return False


class Video(Source):
    """A video file, decoded frame by frame into JPEG (quality 95) or PNG."""

    kind = "video"

    def __init__(self, name: str, path: Path, later: Sequence[Path] = (), *, png: bool = False) -> None:
        """Take a video that goes on in the files `later`, by default in `later_chapters`."""
        self.name, self.path = name, path
        self.suffix = ".png" if png else ".jpg"
        chapters = (path, *(later or later_chapters(path)))
        times_ns = {chapter: video_times_ns(chapter) for chapter in chapters}
        self._timed = all(times_ns.values())
        """Whether all frames have presentation times, by which they are selected."""
        self._times_ns: dict[Path, Sequence[int]] = {
            chapter: own_times_ns if self._timed else range(sum(1 for _ in video_pictures(chapter)))
            for chapter, own_times_ns in times_ns.items()
        }
        """The presentation times of each file's frames in ns, or their numbers."""
        self.numbers = range(sum(map(len, self._times_ns.values())))
        # The first frames of all videos belong together unless a table says otherwise.
        self.name_numbers = [(number,) for number in self.numbers]
        self.fps, notes = describe_video(path)
        names = ", ".join(chapter.name for chapter in chapters[1:])
        goes_on = [f"{path.name} goes on in {names}"] if names else []
        self.notes = (*notes, *goes_on, *_describe_links(chapters))
        if not self.numbers:
            raise BadInputError(f"no frame of {path} can be decoded", hint=DAMAGED)

    def own_times_ns(self) -> Sequence[int]:
        """Return the presentation times of all frames, ns; none if a file lacks them."""
        if not self._timed:
            return ()
        times_ns = self._times_ns
        shifts = chapter_shifts_ns([*times_ns.values()])
        return [at + shift for own, shift in zip(times_ns.values(), shifts, strict=True) for at in own]

    def frames(self, indices: Sequence[int]) -> Iterator[tuple[int, bytes, tuple[int, int]]]:
        """See `Source.frames`."""
        first = 0
        for chapter, times_ns in self._times_ns.items():
            size = len(times_ns)
            inner = [index - first for index in indices if first <= index < first + size]
            # Selected by time, a frame that cannot be decoded does not shift the others.
            chosen = {times_ns[index]: index for index in inner}
            for place, image in video_pictures(chapter, chosen, by_time=self._timed):
                yield first + chosen[place], encode_image(image, self.suffix), image.shape[1::-1]
            first += size


def later_chapters(path: Path) -> list[Path]:
    """Return the further files of a recording that its camera split, in order.

    A GoPro names them: GX02... after GX01..., GP01... after GOPR.... Any camera's files are one recording if
    their counters follow, each begins where the one before ends, and all but the last are equally long.
    """
    if (match := _FIRST_CHAPTER.fullmatch(path.stem)) is not None:
        kind, number = ("GP", match["old"]) if match["old"] else (match["kind"], match["number"])
        beside = (
            path.with_name(f"{kind}{chapter:02}{number}{path.suffix}")
            for chapter in range(1 if match["old"] else 2, 100)
        )
        return list(takewhile(Path.is_file, beside))
    parts, form = [path], re.sub(r"\d+", "#", path.name)
    others = [file for file in sorted(path.parent.iterdir()) if re.sub(r"\d+", "#", file.name) == form]
    while (after := next((file for file in others if _goes_on(path, parts[-1], file)), None)) is not None:
        parts.append(after)
    return parts[1:]


def _goes_on(first: Path, before: Path, path: Path) -> bool:
    """Return whether a recording that begins with the file `first` goes on in `path` after `before`."""
    counters = (numbers_in(_DATE.sub("", name)) for name in (before.stem, path.stem))
    steps = {b - a for a, b in zip(*counters, strict=False)}
    # A counter beside the time of day.
    if path == before or not (steps <= {0, 1} or (min(steps) >= 0 and 1 in steps)):
        return False
    (_, whole_s), (began_s, own_s), (next_s, next_own_s) = map(clip_span, (first, before, path))
    if began_s is None or next_s is None:
        return False
    slack_s = max(PART_SLACK_S, PART_SLACK * whole_s)
    equal = abs(own_s - whole_s) <= slack_s and next_own_s <= whole_s + slack_s
    return equal and abs(next_s - began_s - own_s) <= min(TOUCHING_S, own_s / 2)


def clip_span(path: Path) -> tuple[float | None, float]:
    """Return when a video began, s since 1970 by its camera's clock or its name, and its length, s.

    Return None and 0 if it is unreadable.
    """
    began_s, seconds = None, 0.0
    with suppress(BadInputError, NotAvailableError):
        began_s, seconds = video_span(path, path.stat().st_mtime_ns)
        began_s = name_time_ns(path) / 1e9 if began_s is None else began_s
    return began_s, seconds


def chapter_shifts_ns(times_ns: Sequence[Sequence[int]]) -> list[int]:
    """Return what to add to the times of each of a recording's chapters, ns; the first one's stay.

    `times_ns`: each chapter's frames. A camera goes on with the next one without a gap.
    """
    shifts, begun_ns, last_ns, count = [0], times_ns[0][0], times_ns[0][-1], len(times_ns[0])
    for own_ns in times_ns[1:]:
        period_ns = round((last_ns - begun_ns) / (count - 1)) if count > 1 else 0
        shifts.append(last_ns + period_ns - own_ns[0])
        last_ns, count = own_ns[-1] + shifts[-1], count + len(own_ns)
    return shifts


def videos_in(folder: Path) -> list[Path]:
    """Return the videos of a folder by name, each by its first chapter; none without the folder."""
    if not folder.is_dir():
        return []
    videos = [path for path in folder.iterdir() if path.suffix.lower() in VIDEO_SUFFIXES and path.is_file()]
    return sorted(set(videos) - {later for path in videos for later in later_chapters(path)})


def images_in(folder: Path) -> list[Path]:
    """Return the image files of a folder, unordered."""
    return [
        path
        for path in folder.iterdir()
        if path.suffix.lower() in IMAGE_SUFFIXES and path.is_file() and not path.name.startswith(".")
    ]


def folders_below(
    folder: Path, depth: int = MAX_DEPTH, seen: frozenset[Path] = frozenset()
) -> Iterator[Path]:
    """Yield a folder and all below it in order, without hidden ones, and each only once along links."""
    # A link that leads in a circle is no folder, and has no real path.
    if not folder.is_dir() or folder.name.startswith(".") or not depth:
        return
    if (own := folder.resolve()) in seen:
        return
    yield folder
    for path in sorted(folder.iterdir(), key=lambda path: natural_order(path.name)):
        yield from folders_below(path, depth - 1, seen | {own})


def numbers_in(name: str) -> Numbers:
    """Return the numbers in a name."""
    return tuple(map(int, re.findall(r"\d+", name)))


def name_time_ns(path: Path) -> int:
    """Return the time in a file's name, ns: a date and time with a fraction, or digits of a Unix time.

    Examples: IMG_20260131_142530_123, 2026-01-31T14-25-30.123456, or 10, 13, 16 or 19 digits of s, ms, us or
    ns, with a fraction after a point. Digits that begin with 0 are a frame's number. Raises BadInputError if
    there is none.
    """
    if (unix_ns := unix_time_ns(path)) is not None:
        return unix_ns
    if (match := _DATE.search(path.stem)) is None:
        raise BadInputError(
            f"the name of {path} has no time", hint="such as IMG_20260131_142530_123.jpg, or ns since 1970"
        )
    return _date_ns(path, match, match[7])


def unix_time_ns(path: Path) -> int | None:
    """Return the Unix time in a file's name, ns, which has no zone; None if there is none."""
    for digits, fraction in _EPOCH.findall(path.stem):
        if (places := _EPOCH_NS.get(len(digits))) is not None:
            return int(digits + fraction[:places].ljust(places, "0"))
    return None


def exif_time_ns(path: Path, *, zoned: bool = False) -> int:
    """Return a JPEG's capture time in EXIF, ns; `zoned`: minus its difference from UTC, which it states.

    Raises BadInputError if there is none.
    """
    exif = _exif_of(path)
    if (match := _DATE.search(exif.date)) is None:
        raise BadInputError(f"{path} has no EXIF that says when it was taken", hint=_OTHER_TIMES)
    part = exif.part_of_second.strip()
    if part and not (part.isascii() and part.isdigit()):
        raise BadInputError(
            f"{path}: SubSecTimeOriginal in its EXIF is {part!r}, which is not a number", hint=_OTHER_TIMES
        )
    return _date_ns(path, match, part, exif.offset if zoned else "+00:00")


def states_zone(path: Path) -> bool:
    """Return whether a JPEG's EXIF states its time zone. Raises as `exif_time_ns`."""
    return _OFFSET.fullmatch(_exif_of(path).offset) is not None


def _exif_of(path: Path) -> Exif:
    with rejecting(f"the EXIF of {path} is broken", ValueError, hint=_OTHER_TIMES):
        return read_exif(read_input(path))


def _date_ns(path: Path, found: re.Match[str], fraction: str, zone: str = "+00:00") -> int:
    with rejecting(f"{path} has an invalid time", ValueError, hint=_OTHER_TIMES):
        moment = datetime.strptime(" ".join([*found.groups()[:6], zone]), "%Y %m %d %H %M %S %z")
    return round(moment.timestamp()) * 1_000_000_000 + int((fraction or "0")[:9].ljust(9, "0"))


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """The cameras in a program's folder, with its times and calibration if it has them."""

    path: Path
    """Folder of the cameras."""
    sources: tuple[Source, ...]
    program: str = ""
    """Name of the program that made it, if the importer's name is not specific enough."""
    timeline: Timeline | None = None
    """Times that the program stored."""
    times_of: str = ""
    """What these are times of, if not of what the program means to store."""
    timestamps: Sequence[tuple[str, Path]] = ()
    """Tables of those times, each with the name of its camera, or '' if it names the cameras."""
    same_frames: bool = False
    """Whether frames of equal number are one instant, at the videos' own rate."""
    calibration: Path | None = None
    """The program's calibration of this recording."""
    beside: Path | None = None
    """A calibration beside the recording, used if it fits."""
    views: Views | None = None
    """The calibration, if it is in the recording itself."""
    unit: str | None = None
    record: ExportRecord | None = None
    """The session from which an export of ours was made."""
    take: str = ""
    """Name of this one of several recordings."""
    notes: Sequence[str] = ()
