"""Alignment of cameras by flashes that both saw, or a lamp switched on or off, using rolling-shutter rows.

The lit rows' edges give the time much more precisely than the frame interval. A video does not state its
exposure and readout times. The observed edges restrict both to a range, and each combination in that range to
a range of offsets. The result is the whole set of possible offsets, not the likeliest one.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from capture_app.common.errors import BadInputError
from capture_app.session.alignment.alignment_method import AlignmentMethod
from capture_app.session.alignment.clock_line import CRYSTAL_PPM
from capture_app.session.format.common_times import CameraTimes
from capture_app.session.format.lens import Array
from capture_app.session.importing.video_tracks import open_container

BANDS = 120
"""Maximum number of bands that the rows are averaged to."""
COLUMNS = 16
AROUND = 4
"""Number of frames on either side that a frame's brightness is compared with, skipping its neighbours.

The neighbours may show the same flash.
"""
EDGE_ROWS = 0.05
"""Part of the frame's height near its first or last row where an edge may belong to the next frame."""
MIN_RISE = 0.12
"""Minimum relative rise in brightness by a flash, in at least one row of twenty."""
CLEAR = 8.0
"""Minimum change in brightness by a flash, relative to the typical change."""
LONGEST_FRAMES = 2.5
"""Maximum duration of a flash, in frames."""
MIN_STEP = 0.25
"""Minimum relative change of the whole image's brightness by a lamp, within three frames."""
STEADY = 0.2
"""Maximum variation of brightness before and after a lamp's change, relative to that change."""
SOFT = 0.2
"""Maximum difference between half brightness and half exposure, relative to the exposure.

They differ because pixels are not linear.
"""
NEAR_FRAMES = 0.9
"""Maximum distance, in frames, between flashes that a rough offset matches."""
MIN_MATCHES = 3
"""Minimum number of matching flashes, if both cameras saw that many: two can match by chance.

Each camera misses some flashes between its frames.
"""
CANDIDATES = 6
"""Maximum number of candidate offsets."""
MAX_FITTED = 30
"""Maximum number of flashes that are fitted; more add hardly any information."""
EDGE_S = 2.5e-4
"""Maximum error of an observed edge, including the duration of the flash."""
MIN_BAR_S = 4e-4
"""Minimum half width of the possible offsets: below it edges contradict each other, and tolerance grows."""
READOUTS, EXPOSURES = 100, 3
"""Grid sizes for the unknown readout time and exposure time."""
MAX_DRIFT_PPM = 3 * CRYSTAL_PPM
_ALONE = "one flash or lamp alone, taken for the same"


@dataclass(frozen=True)
class Edge:
    """Place in the frame (0..1, top to bottom) where rows begin or stop being lit, and the frame's time.

    An edge before or after the frame is midway between two frames that are `gap_s` apart, in place and time.
    `soft`: uncertainty of the place, in frame heights.
    """

    at_s: float
    down: float = 0.5
    gap_s: float | None = None
    soft: float = 0.0


@dataclass(frozen=True)
class Flash:
    """A flash in one camera's own times: the rows that it lit. A lamp's change has one edge as both."""

    start: Edge
    end: Edge
    step: int = 0
    """1 for a lamp switched on, -1 for one switched off, 0 for a flash."""

    @property
    def rough_s(self) -> float:
        """Approximate time of the flash, s."""
        return (self.start.at_s + self.end.at_s) / 2


@dataclass(frozen=True, eq=False)
class Lights:
    """Brightness (n, bands) of a video's frames, and their own times (n,), s."""

    times_s: Array
    bands: Array

    @property
    def period_s(self) -> float:
        """Typical frame interval, s."""
        return float(np.median(np.diff(self.times_s)))

    def flashes(self) -> list[Flash]:
        """Return all flashes and lamp changes, in order."""
        if len(self.times_s) < 2 * AROUND + 3:
            return []
        lamps = self._lamps()
        changed = {frame + k for frame in lamps for k in range(-AROUND, AROUND + 1)}
        rises = self._rises()
        tops = np.quantile(rises, 0.95, axis=1)
        min_rise = max(MIN_RISE, CLEAR * 1.4826 * float(np.median(np.abs(tops - np.median(tops)))))
        lit = np.array([frame for frame in np.flatnonzero(tops > min_rise) if frame not in changed], np.intp)
        flashes = [self._lamp(frame) for frame in lamps]
        flashes += [flash for group in _runs(lit) if (flash := self._flash(rises, group)) is not None]
        return sorted(flashes, key=lambda one: one.rough_s)

    def _lamps(self) -> list[int]:
        """Return the frames where a lamp is switched: brightness steady before and after, at two levels."""
        means = self.bands.mean(1)
        windows = np.lib.stride_tricks.sliding_window_view(means, AROUND)
        frames = np.arange(AROUND + 1, len(means) - AROUND - 1)
        before, after = windows[frames - AROUND - 1], windows[frames + 2]
        levels = np.median(before, 1), np.median(after, 1)
        change = np.abs(levels[1] - levels[0])
        steady = np.maximum(np.ptp(before, 1), np.ptp(after, 1)) < STEADY * change
        jumps = frames[steady & (change > MIN_STEP * (np.minimum(*levels) + 8))]
        return [int(max(group, key=lambda at: abs(means[at + 1] - means[at - 1]))) for group in _runs(jumps)]

    def _lamp(self, frame: int) -> Flash:
        """Return a lamp's change near a frame, at the row that received half of the light."""
        before = np.median(self.bands[frame - 1 - AROUND : frame - 1], 0)
        change = np.median(self.bands[frame + 2 : frame + 2 + AROUND], 0) - before
        size, first = len(before), frame - 1
        clear = np.flatnonzero(np.abs(change) > np.abs(change).max() / 4)
        shares = (self.bands[first : first + 3] - before)[:, clear] / change[clear]
        rows = np.concatenate([np.interp(np.arange(size), clear, part) for part in shares])
        at = min(int((rows < 0.5).sum()), 3 * size - 1)
        soft = SOFT * float(((rows > 0.1) & (rows < 0.9)).sum()) / 0.8 / size
        own, band = first + at // size, at % size
        edge = Edge(float(self.times_s[own]), band / size, soft=soft)
        if not EDGE_ROWS * size <= band < size - EDGE_ROWS * size:
            edge = self._hidden(own, own + (-1 if band < EDGE_ROWS * size else 1), soft)
        return Flash(edge, edge, 1 if change.mean() > 0 else -1)

    def _hidden(self, frame: int, other: int, soft: float = 0.0) -> Edge:
        """Return an edge between two frames."""
        times_s = self.times_s[[frame, other]]
        return Edge(float(times_s.mean()), gap_s=float(np.ptp(times_s)), soft=soft)

    def _rises(self) -> Array:
        """Return the relative rise of each band over the surrounding frames, except the direct neighbours."""
        padded = np.pad(self.bands, ((AROUND, AROUND), (0, 0)), mode="edge")
        around = [padded[k : k + len(self.bands)] for k in range(2 * AROUND + 1) if abs(k - AROUND) > 1]
        typical = np.median(np.stack(around), axis=0)
        return np.asarray((self.bands - typical) / (typical + 8))

    def _flash(self, rises: Array, group: NDArray[np.intp]) -> Flash | None:
        first, last = max(1, int(group[0]) - 1), min(len(rises) - 2, int(group[-1]) + 1)
        if last - first > LONGEST_FRAMES + 2:
            return None
        size = rises.shape[1]
        rows = rises[first : last + 1].ravel()
        lit = rows > float(np.median(rows[rows > 0.4 * rows.max()])) / 2
        # Narrow dark or bright objects are not edges.
        width = max(1, size // 40)
        padded = np.pad(lit.astype(float), width, mode="edge")
        on = np.flatnonzero(np.convolve(padded, np.ones(2 * width + 1) / (2 * width + 1), mode="valid") > 0.5)
        if not len(on) or on[-1] - on[0] + 1 > 1.3 * len(on):
            return None
        return Flash(
            self._edge(rows, int(on[0]), first, size, before=True),
            self._edge(rows, int(on[-1]), first, size, before=False),
        )

    def _edge(self, rows: Array, at: int, first: int, size: int, *, before: bool) -> Edge:
        frame, band = first + at // size, at % size
        near = max(1, int(EDGE_ROWS * size))
        if band < near if before else band >= size - near:
            return self._hidden(frame, frame + (-1 if before else 1))
        begin = frame - first
        own = rows[begin * size : (begin + 1) * size]
        inside = own[band : band + 3 * near] if before else own[max(0, band - 3 * near + 1) : band + 1]
        half = float(np.median(inside)) / 2
        crossings = [
            k - 1 + (half - own[k - 1]) / (own[k] - own[k - 1])
            for k in range(max(1, band - 3 * near), min(size, band + 3 * near + 1))
            if (own[k - 1] < half) == before and (own[k] < half) != before and own[k] != own[k - 1]
        ]
        return Edge(float(self.times_s[frame]), (float(np.median(crossings or [band])) + 0.5) / size)


def _runs(frames: NDArray[np.intp]) -> list[NDArray[np.intp]]:
    """Split ascending frame numbers into runs of consecutive ones."""
    return np.split(frames, np.flatnonzero(np.diff(frames) > 1) + 1) if len(frames) else []


def read_lights(path: Path) -> Lights:
    """Return the brightness of a video's frames as the sensor read them, up to a damaged one.

    Raises BadInputError with a short reason if there is none.
    """
    lamps: list[tuple[float, Array]] = []
    why = "it has no pictures"
    try:
        with open_container(path) as (_, container):
            for stream in container.streams.video[:1]:
                stream.thread_type = "AUTO"
            for frame in container.decode(video=0) if container.streams.video else ():
                if frame.pts is not None:
                    small = frame.reformat(
                        COLUMNS, min(BANDS, frame.height), format="gray", interpolation="AREA"
                    )
                    lamps.append((float(frame.pts * frame.time_base), small.to_ndarray().mean(1)))
    except BadInputError as error:
        why = error.what
    if not lamps:
        raise BadInputError(why)
    lamps.sort(key=lambda one: one[0])
    return Lights(np.array([at for at, _ in lamps]), np.stack([bands for _, bands in lamps]))


Pair = tuple[Flash, Flash]
Range = tuple[float, float]


def match_flashes(reference: Lights, camera: Lights) -> CameraTimes:
    """Return the camera's times against the reference's; without an offset, the reason."""
    seen = reference.flashes(), camera.flashes()
    for name, flashes in zip(("the reference", "it"), seen, strict=True):
        if not flashes:
            return CameraTimes(reason=f"{name} saw no flash, nor a lamp that went on or off")
    periods = reference.period_s, camera.period_s
    best: CameraTimes | None = None
    max_pairs = 0
    for pairs in _agreeing(*seen, max(periods)):
        if best is not None and len(pairs) < max_pairs:
            break
        # All pairs, or all but one: that pair may be two flashes that merged.
        others = [pairs[:k] + pairs[k + 1 :] for k in range(len(pairs)) if len(pairs) > MIN_MATCHES]
        fit = next(filter(None, (_fit(choice, *periods) for choice in (pairs, *others))), None)
        if fit is not None and best is not None:
            return CameraTimes(reason="the flashes they saw fit at several offsets")
        if fit is not None:
            best, max_pairs = fit, len(pairs)
    return best or CameraTimes(reason="the flashes they saw fit at no offset")


def _agreeing(seen: Sequence[Flash], others: Sequence[Flash], period_s: float) -> list[list[Pair]]:
    """Return the flashes that both saw, for each offset that matches enough of them, best offset first."""
    near_s = NEAR_FRAMES * period_s
    min_matches = min(MIN_MATCHES, len(seen), len(others))
    groups: list[tuple[float, list[Pair]]] = []
    for first, other in product(seen, others):
        offset_s = first.rough_s - other.rough_s
        pairs = []
        for flash in others:
            nearest = min(seen, key=lambda other: abs(other.rough_s - flash.rough_s - offset_s))
            # Clock drift shifts flashes that are far from this one by more.
            slack_s = near_s + MAX_DRIFT_PPM * 1e-6 * abs(flash.rough_s - other.rough_s)
            if abs(nearest.rough_s - flash.rough_s - offset_s) < slack_s and nearest.step == flash.step:
                pairs.append((nearest, flash))
        if len(pairs) >= min_matches:
            groups.append((offset_s, pairs))
    distinct: list[tuple[float, list[Pair]]] = []
    for offset_s, pairs in sorted(groups, key=lambda group: -len(group[1])):
        if all(abs(offset_s - other_s) > 3 * near_s for other_s, _ in distinct):
            distinct.append((offset_s, pairs))
    return [pairs for _, pairs in distinct[:CANDIDATES]]


def _fit(pairs: Sequence[Pair], reference_s: float, camera_s: float) -> CameraTimes | None:
    """Return the centre and half width of all offsets and rates that the edges allow; None if none fits."""
    if len(pairs) > MAX_FITTED:
        pairs = [pairs[round(k)] for k in np.linspace(0, len(pairs) - 1, MAX_FITTED)]
    at = np.array([other.rough_s for _, other in pairs])
    epoch = float(at.mean())
    for tolerance in (EDGE_S, 2 * EDGE_S, 4 * EDGE_S, 8 * EDGE_S):
        reference_moments = _moments([pair for pair, _ in pairs], reference_s, tolerance)
        camera_moments = _moments([other for _, other in pairs], camera_s, tolerance)
        # Minimum and maximum offset for every combination of both cameras' readout and exposure times.
        lowest = (reference_moments[:, None, :, 0] - camera_moments[None, :, :, 1]).reshape(-1, len(pairs))
        highest = (reference_moments[:, None, :, 1] - camera_moments[None, :, :, 0]).reshape(-1, len(pairs))
        (low, high), (slow, fast) = _lines(at - epoch, lowest, highest)
        if high - low > 2 * MIN_BAR_S:
            return CameraTimes(
                offset_ns=round((low + high) / 2 * 1e9),
                uncertainty_ns=round((high - low) / 2 * 1e9),
                rate_ppm=round((slow + fast) / 2 * 1e6, 4),
                rate_uncertainty_ppm=round((fast - slow) / 2 * 1e6, 4),
                epoch_local_ns=round(epoch * 1e9),
                source="flash",
                reason=_ALONE if len(pairs) == 1 else "",
            )
    return None


def _moments(flashes: Sequence[Flash], period_s: float, tolerance_s: float) -> Array:
    """Return the own times (combinations, flashes, 2) between which each flash happened.

    The combinations are all readout and exposure times that fit. With the readout R, the exposure E and a
    frame's time t in the middle of its middle row's exposure, a flash at T lights the rows from t + R (down -
    1/2) = T - E/2 to T + E/2.
    """
    readout_s = np.linspace(0, period_s, READOUTS)
    starts, ends = (
        np.stack([_range(getattr(flash, side), readout_s, tolerance_s) for flash in flashes], axis=1)
        for side in ("start", "end")
    )
    # A lamp's edge is at the row with light during half of its exposure, whatever the exposure time.
    lasting = np.array([not flash.step for flash in flashes])
    shortest = (ends[..., 0] - starts[..., 1]).max(1, where=lasting, initial=0.0)
    longest = (ends[..., 1] - starts[..., 0]).min(1, where=lasting, initial=period_s)
    fits = shortest <= longest
    moments = []
    for part in np.linspace(0, 1, EXPOSURES):
        half = (shortest + part * (longest - shortest))[fits, None] / 2 * lasting
        low = np.maximum(starts[fits, :, 0] + half, ends[fits, :, 0] - half)
        high = np.minimum(starts[fits, :, 1] + half, ends[fits, :, 1] - half)
        moments.append(np.stack([low, high], axis=-1)[(low <= high).all(1)])
    return np.concatenate(moments)


def _range(edge: Edge, readout_s: Array, tolerance_s: float) -> Array:
    """Return min and max own time (n, 2) of the mid-exposure of the edge's row, for readouts (n,)."""
    half_width = tolerance_s + edge.soft * readout_s
    if edge.gap_s is not None:
        half_width = half_width + np.maximum(edge.gap_s - readout_s, 0) / 2 + EDGE_ROWS * readout_s
    place = edge.at_s + readout_s * (edge.down - 0.5)
    return np.stack([place - half_width, place + half_width], axis=-1)


def _lines(at: Array, lowest: Array, highest: Array) -> tuple[Range, Range]:
    """Return the ranges of offset (at 0) and rate of lines from `lowest` to `highest` (combinations, n).

    The ranges of no combination are from infinity down.
    """
    limit = MAX_DRIFT_PPM * 1e-6
    drift = np.abs(at) * limit
    low, high = (lowest - drift).max(1), (highest + drift).min(1)
    slow, fast = np.full(len(lowest), -limit), np.full(len(lowest), limit)
    for i, j in zip(*np.nonzero(at[:, None] < at), strict=True):
        apart = at[j] - at[i]
        slow = np.maximum(slow, (lowest[:, j] - highest[:, i]) / apart)
        fast = np.minimum(fast, (highest[:, j] - lowest[:, i]) / apart)
        if at[i] <= 0 <= at[j]:
            low = np.maximum(low, (lowest[:, i] * at[j] - lowest[:, j] * at[i]) / apart)
            high = np.minimum(high, (highest[:, i] * at[j] - highest[:, j] * at[i]) / apart)
    good = (low <= high) & (slow <= fast)
    offsets, rates = (
        (float(minima[good].min(initial=np.inf)), float(maxima[good].max(initial=-np.inf)))
        for minima, maxima in ((low, high), (slow, fast))
    )
    return offsets, rates


METHOD: AlignmentMethod[Lights] = AlignmentMethod(
    priority=3,
    of_video_times=True,
    read=lambda path, first_s: read_lights(path),
    match=lambda reference, camera, error_s: match_flashes(reference, camera),
    doubt=lambda times: "each may have seen another flash or lamp" if times.reason == _ALONE else "",
)
