"""Search for the panel in a video, and its readings: looks at few frames, and reads still fewer.

The first and the last seconds are looked through, then key frames if the panel was in neither.
"""

from collections import Counter
from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from capture_app.common.errors import BadInputError
from capture_app.companions.panel.finder import panels_seen
from capture_app.companions.panel.light_model import Shutter
from capture_app.companions.panel.panel_track import VISIT_GAP_S, PanelTrack, TrackReading, make_track
from capture_app.companions.panel.visit_reading import Image, read_visit
from capture_app.session.importing.video_tracks import open_container

EDGE_S = 30.0
"""Duration of a video's beginning and end that is looked through, s."""
LOOK_EVERY_S = 0.25
"""Interval between looks: a visit of a second has at least three."""
KEY_EVERY_S = 0.5
VISIT_S = 5.0
"""Maximum duration of a visit that is read, s."""
READINGS = 8
"""Maximum frames of a visit that are read. More hardly help: what they have in common remains."""
Grey = NDArray[np.uint8]


class _Frames:
    """A video's first stream, decoded in parts; times in s, as the video states them."""

    def __init__(self, container: Any) -> None:
        if not container.streams.video:
            raise BadInputError("it has no pictures")
        self._container, self._stream = container, container.streams.video[0]
        self._stream.thread_type = "AUTO"
        base = self._stream.time_base
        self.start_s = float((self._stream.start_time or 0) * base)
        if self._stream.duration is not None:
            duration_s = float(self._stream.duration * base)
        else:
            duration_s = (container.duration or 0) / 1e6
        self.end_s = self.start_s + duration_s

    def frames(self, from_s: float, to_s: float, *, only_key: bool = False) -> Iterator[tuple[float, Any]]:
        """Decode the frames of a part of the video, or its key frames only."""
        self._stream.codec_context.skip_frame = "NONKEY" if only_key else "DEFAULT"
        self._container.seek(int(from_s / self._stream.time_base), stream=self._stream, backward=True)
        for frame in self._container.decode(self._stream):
            if frame.pts is None:
                continue
            at_s = float(frame.pts * self._stream.time_base)
            if at_s >= to_s:
                return
            if at_s >= from_s:
                yield at_s, frame

    def looks(self, from_s: float, to_s: float, every_s: float, *, only_key: bool = False) -> Iterator[float]:
        """Yield the times of frames with a panel, of one frame in `every_s`. Raises BadInputError for two."""
        due_s = -np.inf
        for at_s, frame in self.frames(from_s, to_s, only_key=only_key):
            if at_s < due_s:
                continue
            due_s = at_s + every_s
            names = panels_seen(_grey(frame))
            if len(names) > 1:
                raise BadInputError(
                    f"it sees two panels at {at_s:.1f} s, {' and '.join(names)}: show one to all cameras"
                )
            if names:
                yield at_s


def read_panel_video(path: Path) -> PanelTrack:
    """Return the panel readings of a video.

    Raises BadInputError with a short reason if it shows no readable panel, or several.
    """
    with open_container(path) as (_, container):
        video = _Frames(container)
        head_s = min(video.start_s + EDGE_S, video.end_s)
        tail_s = max(head_s, video.end_s - EDGE_S)
        parts = [(video.start_s, head_s), (tail_s, np.inf)]
        seen = [at_s for part in parts for at_s in video.looks(*part, LOOK_EVERY_S)]
        if not seen and tail_s > head_s:
            seen = list(video.looks(head_s, tail_s, KEY_EVERY_S, only_key=True))
        if not seen:
            where = f" in its first and last {EDGE_S:.0f} s, nor in key frames between"
            raise BadInputError(f"it sees no panel{where if tail_s > head_s else ''}")
        reasons = Counter[str]()
        readings = list(chain.from_iterable(_read_visit(video, visit, reasons) for visit in _visits(seen)))
        if not readings:
            reason, _ = reasons.most_common(1)[0]
            raise BadInputError(f"its panel at {seen[0]:.1f} s cannot be read: {reason}")
        return make_track(readings, alike=0.0)


def _visits(seen_s: list[float]) -> list[tuple[float, float]]:
    """Return begin and end of the first and the last visit: of what the looks saw, at most VISIT_S each."""
    breaks = np.flatnonzero(np.diff(seen_s) > VISIT_GAP_S)
    first = seen_s[0], min(seen_s[breaks[0] if len(breaks) else -1], seen_s[0] + VISIT_S)
    last = max(seen_s[breaks[-1] + 1 if len(breaks) else 0], seen_s[-1] - VISIT_S), seen_s[-1]
    return (
        [first, last] if last[0] > first[1] + VISIT_GAP_S else [(first[0], min(last[1], first[0] + VISIT_S))]
    )


def _read_visit(
    video: _Frames, visit_s: tuple[float, float], reasons: Counter[str]
) -> Iterator[TrackReading]:
    """Yield the readings of a visit, evenly distributed over it, with the time before and after its looks."""
    from_s, to_s = visit_s[0] - LOOK_EVERY_S, visit_s[1] + LOOK_EVERY_S
    due_s = iter(np.linspace(visit_s[0], visit_s[1], READINGS))
    next_s = next(due_s)
    times_s, chosen = list[float](), list[tuple[float, Image]]()
    for at_s, frame in video.frames(from_s, to_s):
        times_s.append(at_s)
        if at_s >= next_s:
            chosen.append((at_s, frame.to_ndarray(format="bgr24")))
            next_s = next((due for due in due_s if due > at_s), np.inf)
    # A frame's rows are exposed and read within its interval, a longer one after a dropped frame aside.
    period_ns = 1e9 * (float(np.median(np.diff(times_s))) if len(times_s) > 1 else LOOK_EVERY_S)
    yield from read_visit(chosen, Shutter(period_ns, period_ns / chosen[0][1].shape[0]), reasons)


def _grey(frame: Any) -> Grey:
    grey = frame.reformat(format="gray").to_ndarray()
    scale = 1920 / max(grey.shape)
    small = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA) if scale < 1 else grey
    return np.asarray(small, np.uint8)
