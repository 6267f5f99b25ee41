"""Videos of a burst in MP4: H.264 or a camera's own JPEGs, each frame with its own time in microseconds."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from capture_app.common.errors import BadInputError, SimulshotError
from capture_app.session.exporting.exported_burst import ExportedBurst
from capture_app.session.format.lens import Picture, Redraw
from capture_app.session.format.manifest import ImageRecord

T = TypeVar("T")
TIME_BASE = Fraction(1, 1_000_000)
_QUALITY: dict[str, str] = {"crf": "17", "preset": "superfast", "bf": "0"}
_LOSSLESS: dict[str, str] = {"qp": "0", "preset": "veryfast", "bf": "0"}
_BT601 = 6  # ITU-T H.273's number for the matrix that JPEG uses too
_LIMITED_RANGE = 1


def write_video(
    path: Path,
    frames: Iterable[tuple[int, Picture]],
    size: tuple[int, int],
    period_ns: int,
    *,
    lossless: bool = False,
    timecode: str = "",
) -> None:
    """Encode frames, each with its time in ns since the video's start, to 1 us; `size` is (width, height).

    `period_ns` is the duration of the last frame, `timecode` the one of the video's start (HH:MM:SS:FF).
    Odd sizes are preserved by not subsampling colour. Lossless is H.264 of the exact RGB values. The caller
    has checked that PyAV is installed. Raises BadInputError if two frames share a microsecond.
    """
    import av

    width, height = size
    scaler = av.video.reformatter.Interpolation
    # Without accurate rounding every image is darker by half a level.
    rounding = scaler.BICUBIC | scaler.ACCURATE_RND | scaler.FULL_CHR_H_INP
    with _container(path, size) as container:
        unreduced = "yuv444p" if width % 2 or height % 2 else "yuv420p"
        stream = container.add_stream(
            "libx264rgb" if lossless else "libx264",
            rate=Fraction(1_000_000_000, period_ns).limit_denominator(),
            options=_LOSSLESS if lossless else _QUALITY,
            width=width,
            height=height,
            pix_fmt="bgr24" if lossless else unreduced,
        )
        stream.time_base = stream.codec_context.time_base = TIME_BASE
        if timecode:
            stream.metadata["timecode"] = timecode
        if not lossless:
            stream.codec_context.colorspace = _BT601
            stream.codec_context.color_range = _LIMITED_RANGE
        for since_us, picture in _in_us(path, frames):
            frame = av.VideoFrame.from_numpy_buffer(np.ascontiguousarray(picture), format="bgr24")
            if not lossless:
                frame = frame.reformat(format=stream.pix_fmt, interpolation=rounding)
            frame.pts, frame.time_base = since_us, TIME_BASE
            frame.duration = max(1, period_ns // 1000)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))


def copy_jpegs(
    path: Path, frames: Iterable[tuple[int, bytes]], size: tuple[int, int], period_ns: int
) -> None:
    """Write JPEGs unchanged as a video, Motion JPEG in MP4; parameters and errors as in `write_video`."""
    import av

    with _container(path, size) as container:
        rate = Fraction(1_000_000_000, period_ns).limit_denominator()
        stream = container.add_stream("mjpeg", rate=rate, width=size[0], height=size[1], pix_fmt="yuvj420p")
        stream.time_base = stream.codec_context.time_base = TIME_BASE
        for since_us, data in _in_us(path, frames):
            packet = av.Packet(data)
            packet.stream, packet.time_base, packet.is_keyframe = stream, TIME_BASE, True
            packet.pts = packet.dts = since_us
            packet.duration = max(1, period_ns // 1000)
            container.mux(packet)


@contextmanager
def _container(path: Path, size: tuple[int, int]) -> Iterator[Any]:
    """Open an MP4 to write within the block. Raises OSError, SimulshotError."""
    import av

    try:
        # In milliseconds, MP4's default, the time before the first frame would lose its microseconds.
        with av.open(str(path), "w", format="mp4", options={"movie_timescale": "1000000"}) as container:
            yield container
    except av.FFmpegError as error:
        if isinstance(error, OSError):
            raise OSError(error.errno, error.strerror, str(path)) from error
        raise SimulshotError(
            f"cannot encode {path.name} ({size[0]}x{size[1]}): {error}",
            hint="export the images instead: --to mcap",
        ) from error


def _in_us(path: Path, frames: Iterable[tuple[int, T]]) -> Iterator[tuple[int, T]]:
    """Yield frames with their times in us. Raises BadInputError if two share a microsecond."""
    last_us = -math.inf
    for since_ns, frame in frames:
        since_us = (since_ns + 500) // 1000
        if since_us <= last_us:
            raise BadInputError(
                f"{path.name}: two frames within the same microsecond, {since_us}",
                hint="import the recording again with correct times, or export to mcap",
            )
        last_us = since_us
        yield since_us, frame


Shown = tuple[int, int, ImageRecord | None]
"""A video frame: its instant, its time in ns since the video's start, and its image; None for black."""


def at_own_times(burst: ExportedBurst, camera: str) -> list[Shown]:
    """Return a camera's frames at their own times since the burst's first image, without missing images."""
    return [(image.instant, image.leader_ns - burst.origin_ns, image) for image in burst.images_of(camera)]


def at_instants(burst: ExportedBurst, camera: str, instants: Sequence[int]) -> list[Shown]:
    """Return one frame for each of these instants, at the instant's time since the first of them."""
    times_ns = burst.instants_ns
    return [(n, times_ns[n] - times_ns[instants[0]], burst.image_at(camera, n)) for n in instants]


def write_camera(
    burst: ExportedBurst,
    path: Path,
    shown: Sequence[Shown],
    camera: str,
    *,
    redraw: Redraw | None = None,
    size: tuple[int, int] | None = None,
    file: str = "",
    timecode: str = "",
) -> None:
    """Write a camera's video named `file` in the export; `redraw` changes its images to `size`.

    `timecode` is as in `write_video`.
    """
    width, height = size or burst.size(camera)
    frames = (
        (since_ns, np.zeros((height, width, 3), np.uint8) if image is None else burst.load(image, redraw)[1])
        for _, since_ns, image in shown
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    lossless = burst.lossless
    write_video(path, frames, (width, height), burst.period_ns, lossless=lossless, timecode=timecode)
    burst.frames |= {(camera, n): (file or path.name, k, image) for k, (n, _, image) in enumerate(shown)}


def copy_camera(burst: ExportedBurst, path: Path, shown: Sequence[Shown], camera: str) -> None:
    """Write a camera's video of its own JPEGs, unchanged; none may be missing."""
    images = [(since_ns, image) for _, since_ns, image in shown if image is not None]
    frames = ((since_ns, burst.read(image)) for since_ns, image in images)
    copy_jpegs(path, frames, burst.size(camera), burst.period_ns)
    burst.frames |= {(camera, n): (path.name, k, image) for k, (n, _, image) in enumerate(shown)}


def write_paired_videos(
    burst: ExportedBurst,
    folder: Path,
    files: Mapping[str, str],
    redraws: Mapping[str, Redraw | None] | None = None,
) -> None:
    """Write each camera's video in `folder`, one frame for each instant, black if its image is missing.

    For programs that take frame n of all videos as simultaneous. Adds notes on black frames and uneven
    spacing.
    """
    for camera, file in files.items():
        shown = at_instants(burst, camera, range(len(burst.instants_ns)))
        write_camera(burst, folder / file, shown, camera, redraw=(redraws or {}).get(camera), file=file)
    if blank := sum(image is None for _, _, image in burst.frames.values()):
        burst.notes.append(f"{blank} frames are black: their images are missing or of another moment")
    burst.notes += spacing_notes(burst.instants_ns, burst.period_ns)


def spacing_notes(times_ns: Iterable[int], period_ns: int) -> list[str]:
    """Return a note if these times would mislead a program that assumes a constant frame rate."""
    gaps = np.diff(np.array(list(times_ns), np.int64))
    if len(gaps) == 0 or np.ptp(gaps) <= period_ns // 20:
        return []
    return ["the instants are unevenly spaced: programs that count frames at one rate get their times wrong"]
