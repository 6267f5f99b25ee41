"""Tracks of a video: its container, opened for those who read sound, dates or metadata."""

import importlib
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture_app.common.errors import BadInputError

MIN_GAP_S = 0.02
"""Shorter gaps between a sound track's frames are rounding of their times."""
MAX_SILENCE_S = 600.0
"""Longest gaps of a track in all: they are filled with silence, which takes memory as sound does."""


@contextmanager
def open_container(path: Path) -> Iterator[tuple[Any, Any]]:
    """Open a video; yield the package PyAV and the container. Raises BadInputError with a short reason."""
    try:
        av: Any = importlib.import_module("av")
    except ImportError:
        raise BadInputError("PyAV is not installed") from None
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
