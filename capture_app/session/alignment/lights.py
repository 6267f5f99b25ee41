"""How bright each part of a camera's frames is, row by row, and the flashes that it saw.

A rolling shutter shows a flash on the rows that were exposing just then: where they begin and end tells when,
far finer than a frame.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture_app.session.alignment.container import read_container

Array = NDArray[np.float64]

BANDS = 120
"""Rows are taken together to so many bands at most."""
COLUMNS = 16
AROUND = 4
"""A frame's brightness is compared with so many to either side, but those beside it: they may show it too."""
EDGE_ROWS = 0.05
"""What begins so near to a frame's first or last row may as well have begun before or after it."""
LEAST_RISE = 0.12
"""A flash makes at least one row of twenty this much brighter."""
CLEAR = 8.0
"""And by so many times what brightness otherwise changes by."""
LONGEST_FRAMES = 2.5
"""What lights up longer is no flash."""


@dataclass(frozen=True)
class Edge:
    """Where rows begin or end to be lit: how far down the frame (0..1), or `hidden` before or after it.

    `at_s` is the frame's own time; of a hidden edge the middle between two frames, which `gap_s` are apart.
    """

    at_s: float
    down: float = 0.5
    hidden: bool = False
    gap_s: float = 0.0


@dataclass(frozen=True)
class Flash:
    """A flash in one camera's own times: the rows that it lit."""

    start: Edge
    end: Edge

    @property
    def rough_s(self) -> float:
        """About when it was."""
        return (self.start.at_s + self.end.at_s) / 2


@dataclass(frozen=True, eq=False)
class Lights:
    """Brightness (n, bands) of a video's frames and their own times (n,), s."""

    times_s: Array
    bands: Array

    @property
    def period_s(self) -> float:
        """The usual time from frame to frame."""
        return float(np.median(np.diff(self.times_s)))

    def flashes(self) -> list[Flash]:
        """All flashes, in order."""
        if len(self.times_s) < 2 * AROUND + 3:
            return []
        rises = self._rises()
        tops = np.quantile(rises, 0.95, axis=1)
        least = max(LEAST_RISE, CLEAR * 1.4826 * float(np.median(np.abs(tops - np.median(tops)))))
        lit = np.flatnonzero(tops > least)
        groups = np.split(lit, np.flatnonzero(np.diff(lit) > 1) + 1) if len(lit) else []
        found = (self._flash(rises, group) for group in groups)
        return [flash for flash in found if flash is not None]

    def _rises(self) -> Array:
        """By what share bands are brighter than in the frames around, those beside them left out."""
        padded = np.pad(self.bands, ((AROUND, AROUND), (0, 0)), mode="edge")
        count = len(self.bands)
        steps = [k for k in range(2 * AROUND + 1) if abs(k - AROUND) > 1]
        around = np.median(np.stack([padded[k : k + count] for k in steps]), axis=0)
        return np.asarray((self.bands - around) / (around + 8))

    def _flash(self, rises: Array, group: NDArray[np.intp]) -> Flash | None:
        first, last = max(1, int(group[0]) - 1), min(len(rises) - 2, int(group[-1]) + 1)
        if last - first > LONGEST_FRAMES + 2:
            return None
        size = rises.shape[1]
        rows = rises[first : last + 1].ravel()
        level = float(np.median(rows[rows > 0.4 * rows.max()]))
        lit = rows > level / 2
        # Narrow dark or bright things are no edges.
        width = max(1, size // 40)
        kernel = np.ones(2 * width + 1) / (2 * width + 1)
        smooth = np.convolve(np.pad(lit.astype(float), width, mode="edge"), kernel, mode="valid") > 0.5
        on = np.flatnonzero(smooth)
        if not len(on) or on[-1] - on[0] + 1 > 1.3 * len(on):
            return None
        return Flash(
            self._edge(rows, int(on[0]), first, size, before=True),
            self._edge(rows, int(on[-1]), first, size, before=False),
        )

    def _edge(self, rows: Array, at: int, first: int, size: int, *, before: bool) -> Edge:
        frame, band = first + at // size, at % size
        step = -1 if before else 1
        near = max(1, int(EDGE_ROWS * size))
        outermost = band < near if before else band >= size - near
        if outermost:
            other = frame + step
            middle = (self.times_s[frame] + self.times_s[other]) / 2
            return Edge(
                float(middle), hidden=True, gap_s=float(abs(self.times_s[frame] - self.times_s[other]))
            )
        begin = frame - first
        own = rows[begin * size : (begin + 1) * size]
        inside = own[band : band + 3 * near] if before else own[max(0, band - 3 * near + 1) : band + 1]
        half = float(np.median(inside)) / 2
        window = range(max(1, band - 3 * near), min(size, band + 3 * near + 1))
        crossings = [
            k - 1 + (half - own[k - 1]) / (own[k] - own[k - 1])
            for k in window
            if (own[k - 1] < half) == before and (own[k] < half) != before and own[k] != own[k - 1]
        ]
        place = float(np.median(crossings)) if crossings else float(band)
        return Edge(float(self.times_s[frame]), (place + 0.5) / size)


def read_lights(path: Path) -> Lights | None:
    """The brightness of a video's frames, as the sensor read them; None without any, or PyAV."""
    found: list[tuple[float, Array]] = []
    read_container(path, lambda _, container: _read(container, found))
    if not found:
        return None
    found.sort(key=lambda one: one[0])
    return Lights(np.array([at for at, _ in found]), np.stack([bands for _, bands in found]))


def _read(container: Any, into: list[tuple[float, Array]]) -> None:
    """Add each frame's own time and bands: those before a fault of the video are kept."""
    if not container.streams.video:
        return
    stream = container.streams.video[0]
    stream.thread_type = "AUTO"
    for frame in container.decode(stream):
        if frame.pts is None:
            continue
        height = min(BANDS, frame.height)
        small = frame.reformat(COLUMNS, height, format="gray", interpolation="AREA")
        grey = small.to_ndarray().astype(np.float64)
        into.append((float(frame.pts * frame.time_base), grey.mean(1)))
