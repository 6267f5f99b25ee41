"""Tracks of a video: its container, opened to read sound, dates or metadata."""

from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress
from datetime import datetime
from functools import cache
from itertools import chain, count
from math import inf
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture_app.common.errors import BadInputError
from capture_app.common.optional_packages import load_optional

MIN_GAP_S = 0.02
"""Shorter gaps between a sound track's frames are rounding of their times."""
MAX_PIXELS = 1 << 26
"""Largest picture of a video, px: eight times 4K; FFmpeg stores up to seventeen of them."""
MAX_SILENCE_S = 600.0
"""Longest gaps of a track in all: they are filled with silence, which takes memory as sound does."""
MAX_RATE_HZ = 1_000_000
"""Highest rate of a track: the filter that resamples it takes memory in proportion, 60 bytes a hertz."""


@contextmanager
def open_container(path: Path) -> Iterator[tuple[Any, Any]]:
    """Open a video; yield the package PyAV and the container.

    Raises BadInputError with a short reason, NotAvailableError without PyAV.
    """
    av = load_optional("av", "export", "reading videos")
    if not path.is_file():
        raise BadInputError("it is not a file")
    try:
        with av.open(str(path), metadata_errors="replace") as container:
            yield av, container
    except (av.FFmpegError, OSError, ValueError):
        raise BadInputError("it cannot be decoded") from None


def read_track(path: Path, rate_hz: int, sample_format: str, channels: int) -> tuple[NDArray[Any], float]:
    """Return a video's first sound track at a rate, and its beginning in the video's own times, s.

    The samples (channels, n) are of a planar format of FFmpeg, `fltp` or `s16p`, with at most so many
    channels, one or two. A gap in the track is filled with silence, so that later sound keeps its time.
    Raises BadInputError with a short reason if there is none, or if its gaps are longer than MAX_SILENCE_S.
    """
    parts: list[NDArray[Any]] = []
    start_s, length, silent = 0.0, 0, 0
    with open_container(path) as (av, container):
        if not container.streams.audio or container.streams.audio[0].codec_context is None:
            raise BadInputError("it has no sound")
        track = container.streams.audio[0]
        if track.codec_context.sample_rate > MAX_RATE_HZ:
            raise BadInputError(f"its sound has {track.codec_context.sample_rate:,} samples a second")
        channels = 1 if track.codec_context.channels == 1 else channels
        layout = "mono" if channels == 1 else "stereo"
        resampler = av.AudioResampler(format=sample_format, layout=layout, rate=rate_hz)
        for frame in chain(container.decode(track), [None]):
            timed = frame is not None and frame.pts is not None
            at_s = float(frame.pts * frame.time_base) if timed else start_s + length / rate_hz
            if not parts:
                start_s = at_s
            made = [block.to_ndarray() for block in resampler.resample(frame)]
            gap = round((at_s - start_s) * rate_hz) - length
            if gap > MIN_GAP_S * rate_hz:
                silent += gap
                if silent > MAX_SILENCE_S * rate_hz:
                    raise BadInputError(f"its sound has holes of {silent / rate_hz:,.0f} s")
                dtype = np.float32 if sample_format == "fltp" else np.int16
                parts.append(np.zeros((channels, gap), dtype))
                length += gap
            parts += made
            length += sum(block.shape[1] for block in made)
    if not parts:
        raise BadInputError("it has no sound")
    return np.concatenate(parts, axis=1), start_s


_INTERLACED = (2, 3, 4, 5)
"""FFmpeg's field orders of frames that are not progressive."""
DAMAGED = "copy it from the camera again, or leave it out"


@contextmanager
def _opened(path: Path) -> Iterator[tuple[Any, Any]]:
    """Open a file that has pictures, as `open_container`; errors name it."""
    try:
        with open_container(path) as (av, container):
            # Where FFmpeg has no decoder, there is no context.
            if not container.streams.video or container.streams.video[0].codec_context is None:
                raise BadInputError("it has no pictures")
            context = container.streams.video[0].codec_context
            if context.width * context.height > MAX_PIXELS:
                raise BadInputError(f"its pictures have {context.width}x{context.height} pixels")
            yield av, container
    except BadInputError as error:
        raise BadInputError(
            f"{path} is not a video that can be decoded: {error.what}", hint=DAMAGED
        ) from error


def describe_video(path: Path) -> tuple[float, list[str]]:
    """Return a video's rate in frames/s, 0 if it states none, and notes for the user on what it holds.

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
    return fps, [f"{path.name} {note}" for note, holds in notes.items() if holds]


@cache
def video_span(path: Path, changed_ns: int) -> tuple[float | None, float]:
    """Return when a video began by its camera's clock, s since 1970, None if it does not say; its length, s.

    `changed_ns`: when the file was changed. Raises as `open_container`.
    """
    dates_s = []
    with open_container(path) as (_, container):
        holders = [container, *container.streams.video[:1]]
        for holder in holders:
            # No camera writes other formats.
            with suppress(ValueError):
                dates_s.append(datetime.fromisoformat(holder.metadata.get("creation_time", "")).timestamp())
        lengths_s = [float(stream.duration * stream.time_base) for stream in holders[1:] if stream.duration]
    # Zero in QuickTime's dates, 1904, means that there is no date.
    return next((date_s for date_s in dates_s if date_s > 0), None), sum(lengths_s)


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
