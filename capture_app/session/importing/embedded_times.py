"""Frame times from the recording itself: video timestamps, file names, EXIF."""

import re
from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from itertools import count
from math import inf
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from capture_app.common.errors import BadInputError
from capture_app.common.optional_packages import load_optional
from capture_app.session.files.untrusted_files import read_input, rejecting
from capture_app.session.reading.decoding import read_exif

_DATE = re.compile(
    r"((?:19|20)\d{2})[-_.:]?(\d{2})[-_.:]?(\d{2})[-_.T ]?(\d{2})[-_.:h]?(\d{2})[-_.:m]?(\d{2})"
    # One or two digits after a dash are a counter within the second.
    r"(?:[.,]|[-_]?(?=\d{3}))?(\d*)"
)
_EPOCH = re.compile(r"(?<!\d)([1-9]\d*)(?:(?:\.|[_-](?=\d{6}(?!\d)|\d{9}(?!\d)))(\d+))?(?!\d)")
_EPOCH_NS = {10: 9, 13: 6, 16: 3, 19: 0}
"""Number of digits of a Unix time, and the power of ten that converts it to ns."""
_INTERLACED = (2, 3, 4, 5)
"""FFmpeg's field orders of frames that are not progressive."""
DAMAGED = "copy it from the camera again, or leave it out"
_OTHER_TIMES = "take the times from elsewhere: --times name, --timestamps CSV or --fps RATE"


TimeSource = Literal["auto", "video", "name", "exif"]
"""Source of a recording's times.

auto    chosen by what the recording has: a table, a phone's metadata
video   from the videos' own timestamps, which may be irregular
name    from the images' file names
exif    from the images' EXIF: capture time with fraction of a second
"""


@contextmanager
def _opened(path: Path) -> Iterator[tuple[Any, Any]]:
    """Open a video; yield the package PyAV and the container. Raises BadInputError, NotAvailableError."""
    if not path.is_file():  # a reader would wait for a pipe
        raise BadInputError(f"{path} is not a file", hint=DAMAGED)
    av = load_optional("av", "export", "reading videos")
    with (
        rejecting(f"{path} is not a video that can be decoded", av.FFmpegError, hint=DAMAGED),
        av.open(str(path), metadata_errors="replace") as container,
    ):
        # Where FFmpeg has no decoder, there is no context.
        if not container.streams.video or container.streams.video[0].codec_context is None:
            raise BadInputError(
                f"{path} has no video in it that can be decoded",
                hint="leave it out, or give the camera's video file",
            )
        yield av, container


def describe_video(path: Path) -> tuple[float, str]:
    """Return a video's rate in frames/s, 0 if it states none, and a note for the user on what it holds.

    Raises as `video_times_ns`.
    """
    with _opened(path) as (av, container):
        stream, cover = container.streams.video[0], av.stream.Disposition.attached_pic
        fps = float(stream.guessed_rate or stream.average_rate or 0)
        interlaced = stream.codec_context.field_order in _INTERLACED
        # As in an .insv of Insta360, which has a lens in each.
        several = sum(not video.disposition & cover for video in container.streams.video) > 1
    apart = f", {500 / fps:.3g} ms apart" if fps else ""
    second = f"ffmpeg -i {path.name} -map 0:v:1 -c copy {path.stem}-2.mp4"
    notes = {
        f"is interlaced: the odd and the even rows of a frame are two instants{apart}": interlaced,
        f"has more than one video stream; the first is imported. For the second: {second}": several,
    }
    return fps, "; ".join(f"{path.name} {note}" for note, holds in notes.items() if holds)


def video_times_ns(path: Path) -> list[int]:
    """Return the presentation times of a video's frames in ns, ascending, without decoding; [] if none.

    Frames that an edit list hides have none. Raises BadInputError if it is not a video, NotAvailableError
    without PyAV.
    """
    with _opened(path) as (_, container):
        stream = container.streams.video[0]
        packets = (packet for packet in container.demux(stream) if not packet.is_discard)
        ticks = {packet.pts for packet in packets if packet.pts is not None}
        return [round(tick * stream.time_base * 1_000_000_000) for tick in sorted(ticks)]


def video_pictures(
    path: Path, places: Collection[int] | None = None, *, by_time: bool = False
) -> Iterator[tuple[int, NDArray[np.uint8]]]:
    """Yield the frames (BGR, H x W x 3, upright) at the requested places, or all, with their places.

    Of pixels that are not square, an image is as wide as a player shows it. A place is a presentation time in
    ns, otherwise the number of a decoded frame. Frames that cannot be decoded are skipped. Raises
    BadInputError if it is not a video.
    """
    with _opened(path) as (av, container):
        scaler = av.video.reformatter.Interpolation
        # Without accurate rounding every image is darker by a level or more.
        rounding = scaler.BICUBIC | scaler.ACCURATE_RND | scaler.FULL_CHR_H_INP | scaler.FULL_CHR_H_INT
        numbers, last = count(), inf if places is None else max(places, default=-1)
        stream = container.streams.video[0]
        for packet in container.demux(stream):
            frames = []
            with suppress(av.InvalidDataError):
                frames = packet.decode()
            for frame, number in zip(frames, numbers, strict=False):
                timed = by_time and frame.pts is not None
                place = round(frame.pts * frame.time_base * 1_000_000_000) if timed else number
                if place > last:
                    return
                if timed == by_time and not frame.is_corrupt and (places is None or place in places):
                    width = round(frame.width * (stream.sample_aspect_ratio or 1))
                    image = frame.to_ndarray(format="bgr24", width=width, interpolation=rounding)
                    yield place, np.ascontiguousarray(np.rot90(image, round(frame.rotation / 90) % 4))


def name_time_ns(path: Path) -> int:
    """Return the time in a file's name, ns: a date and time with a fraction, or digits of a Unix time.

    Examples: IMG_20260131_142530_123, 2026-01-31T14-25-30.123456, or 10, 13, 16 or 19 digits of s, ms, us or
    ns, with a fraction after a point. Digits that begin with 0 are a frame's number. Raises BadInputError if
    there is none.
    """
    for digits, fraction in _EPOCH.findall(path.stem):
        if (places := _EPOCH_NS.get(len(digits))) is not None:
            return int(digits + fraction[:places].ljust(places, "0"))
    if (match := _DATE.search(path.stem)) is None:
        raise BadInputError(
            f"the name of {path} has no time", hint="such as IMG_20260131_142530_123.jpg, or ns since 1970"
        )
    return _date_ns(path, match, match[7])


def exif_time_ns(path: Path) -> int:
    """Return a JPEG's capture time in EXIF, ns. Raises BadInputError if there is none."""
    with rejecting(f"the EXIF of {path} is broken", ValueError, hint=_OTHER_TIMES):
        exif = read_exif(read_input(path))
    if (match := _DATE.search(exif.date)) is None:
        raise BadInputError(f"{path} has no EXIF that says when it was taken", hint=_OTHER_TIMES)
    part = exif.part_of_second.strip()
    if part and not (part.isascii() and part.isdigit()):
        raise BadInputError(
            f"{path}: SubSecTimeOriginal in its EXIF is {part!r}, which is not a number", hint=_OTHER_TIMES
        )
    return _date_ns(path, match, part)


def _date_ns(path: Path, found: re.Match[str], fraction: str) -> int:
    with rejecting(f"{path} has an invalid time", ValueError, hint=_OTHER_TIMES):
        moment = datetime.strptime(" ".join(found.groups()[:6]), "%Y %m %d %H %M %S").replace(tzinfo=UTC)
    return round(moment.timestamp()) * 1_000_000_000 + int((fraction or "0")[:9].ljust(9, "0"))
