"""Alignment of cameras by flashes that both saw, or a lamp switched on or off, using rolling-shutter rows.

The lit rows' edges give the time much more precisely than the frame interval. A video does not state its
exposure and readout times. The observed edges restrict both to a range, and each combination in that range to
a range of offsets. The result is the whole set of possible offsets, not the likeliest one.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture_app.session.alignment.clock_line import CRYSTAL_PPM
from capture_app.session.alignment.tracks import read_container
from capture_app.session.format.common_times import CameraTimes
from capture_app.session.format.lens import Array

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


@dataclass(frozen=True)
class Edge:
    """Position in the frame (0..1, top to bottom) where rows begin or stop being lit.

    A `hidden` edge is before or after the frame. `at_s` is the frame's own time; for a hidden edge, the
    middle between two frames that are `gap_s` apart. `soft`: uncertainty of the position, in frame heights.
    """

    at_s: float
    down: float = 0.5
    hidden: bool = False
    gap_s: float = 0.0
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
        groups = np.split(lit, np.flatnonzero(np.diff(lit) > 1) + 1) if len(lit) else []
        found = (self._flash(rises, group) for group in groups)
        flashes = [flash for flash in found if flash is not None]
        return sorted([*flashes, *(self._lamp(frame) for frame in lamps)], key=lambda one: one.rough_s)

    def _lamps(self) -> list[int]:
        """Return the frames where a lamp is switched: brightness steady before and after, at two levels."""
        means = self.bands.mean(1)
        windows = np.lib.stride_tricks.sliding_window_view(means, AROUND)
        frames = np.arange(AROUND + 1, len(means) - AROUND - 1)
        if not len(frames):
            return []
        before, after = windows[frames - AROUND - 1], windows[frames + 2]
        levels = np.median(before, 1), np.median(after, 1)
        change = np.abs(levels[1] - levels[0])
        steady = np.maximum(np.ptp(before, 1), np.ptp(after, 1)) < STEADY * change
        clear = change > MIN_STEP * (np.minimum(*levels) + 8)
        found = frames[steady & clear]
        groups = np.split(found, np.flatnonzero(np.diff(found) > 1) + 1) if len(found) else []
        return [int(max(group, key=lambda at: abs(means[at + 1] - means[at - 1]))) for group in groups]

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
        near = EDGE_ROWS * size
        own, band = first + at // size, at % size
        edge = Edge(float(self.times_s[own]), band / size, soft=soft)
        if not near <= band < size - near:
            other = own + (-1 if band < near else 1)
            gap_s = float(abs(self.times_s[own] - self.times_s[other]))
            middle_s = float(self.times_s[own] + self.times_s[other]) / 2
            edge = Edge(middle_s, hidden=True, gap_s=gap_s, soft=soft)
        return Flash(edge, edge, 1 if change.mean() > 0 else -1)

    def _rises(self) -> Array:
        """Return the relative rise of each band over the surrounding frames, except the direct neighbours."""
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
        # Narrow dark or bright objects are not edges.
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


def read_lights(path: Path) -> Lights | str:
    """Return the brightness of a video's frames as the sensor read them, or the reason why there is none."""
    found: list[tuple[float, Array]] = []
    why = read_container(path, lambda _, container: _read(container, found))
    if not found:
        return why or "it has no pictures"
    found.sort(key=lambda one: one[0])
    return Lights(np.array([at for at, _ in found]), np.stack([bands for _, bands in found]))


def _read(container: Any, into: list[tuple[float, Array]]) -> None:
    """Add each frame's own time and bands; frames before a decoding error are retained."""
    for stream in container.streams.video[:1]:
        stream.thread_type = "AUTO"
    for frame in container.decode(video=0) if container.streams.video else ():
        if frame.pts is None:
            continue
        height = min(BANDS, frame.height)
        small = frame.reformat(COLUMNS, height, format="gray", interpolation="AREA")
        grey = small.to_ndarray().astype(np.float64)
        into.append((float(frame.pts * frame.time_base), grey.mean(1)))


Pair = tuple[Flash, Flash]
Range = tuple[float, float]


def match_flashes(reference: Lights, camera: Lights) -> CameraTimes:
    """Return the camera's times against the reference's; without an offset, the reason."""
    seen = reference.flashes(), camera.flashes()
    for name, of in zip(("the reference", "it"), seen, strict=True):
        if not of:
            return CameraTimes(reason=f"{name} saw no flash, nor a lamp that went on or off")
    periods = reference.period_s, camera.period_s
    best: CameraTimes | None = None
    max_pairs = 0
    for pairs in _agreeing(*seen, max(periods)):
        if best is not None and len(pairs) < max_pairs:
            break
        found = _fit_robustly(pairs, periods)
        if found.offset_ns is None:
            continue
        if best is not None:
            return CameraTimes(reason="the flashes they saw fit at several offsets")
        best, max_pairs = found, len(pairs)
    return best or CameraTimes(reason="the flashes they saw fit at no offset")


def _agreeing(seen: Sequence[Flash], others: Sequence[Flash], period_s: float) -> list[list[Pair]]:
    """Return the flashes that both saw, for each offset that matches enough of them, best offset first."""
    near_s = NEAR_FRAMES * period_s
    min_matches = min(MIN_MATCHES, len(seen), len(others))
    groups: list[tuple[float, list[Pair]]] = []
    for one in seen:
        for other in others:
            offset_s = one.rough_s - other.rough_s
            pairs = []
            for flash in others:
                nearest = min(seen, key=lambda of: abs(of.rough_s - flash.rough_s - offset_s))
                # Clock drift shifts flashes that are far from this one by more.
                slack_s = near_s + MAX_DRIFT_PPM * 1e-6 * abs(flash.rough_s - other.rough_s)
                near = abs(nearest.rough_s - flash.rough_s - offset_s) < slack_s
                if near and nearest.step == flash.step:
                    pairs.append((nearest, flash))
            if len(pairs) >= min_matches:
                groups.append((offset_s, pairs))
    groups.sort(key=lambda group: -len(group[1]))
    distinct: list[tuple[float, list[Pair]]] = []
    for offset_s, pairs in groups:
        if all(abs(offset_s - other_s) > 3 * near_s for other_s, _ in distinct):
            distinct.append((offset_s, pairs))
    return [pairs for _, pairs in distinct[:CANDIDATES]]


def _fit_robustly(pairs: list[Pair], periods: tuple[float, float]) -> CameraTimes:
    """Fit all pairs, or all but one: that pair may be two flashes that merged."""
    choices = [pairs]
    if len(pairs) > MIN_MATCHES:
        choices += [pairs[:k] + pairs[k + 1 :] for k in range(len(pairs))]
    found = (_fit(choice, *periods) for choice in choices)
    return next((one for one in found if one.offset_ns is not None), CameraTimes())


def _fit(pairs: Sequence[Pair], reference_s: float, camera_s: float) -> CameraTimes:
    """Return the centre and half width of all offsets and rates that the edges allow; empty if none fits."""
    if len(pairs) > MAX_FITTED:
        pairs = [pairs[round(k)] for k in np.linspace(0, len(pairs) - 1, MAX_FITTED)]
    epoch = float(np.mean([other.rough_s for _, other in pairs]))
    at = np.array([other.rough_s for _, other in pairs]) - epoch
    for tolerance in (EDGE_S, 2 * EDGE_S, 4 * EDGE_S, 8 * EDGE_S):
        reference_moments = _moments([one for one, _ in pairs], reference_s, tolerance)
        camera_moments = _moments([other for _, other in pairs], camera_s, tolerance)
        if not len(reference_moments) or not len(camera_moments):
            continue
        # Minimum and maximum offset for every combination of both cameras' readout and exposure times.
        lowest = (reference_moments[:, None, :, 0] - camera_moments[None, :, :, 1]).reshape(-1, len(pairs))
        highest = (reference_moments[:, None, :, 1] - camera_moments[None, :, :, 0]).reshape(-1, len(pairs))
        offsets, rates = _lines(at, lowest, highest)
        if offsets is not None and rates is not None and offsets[1] - offsets[0] > 2 * MIN_BAR_S:
            return CameraTimes(
                offset_ns=round(sum(offsets) / 2 * 1e9),
                uncertainty_ns=round((offsets[1] - offsets[0]) / 2 * 1e9),
                rate_ppm=round(sum(rates) / 2 * 1e6, 4),
                rate_uncertainty_ppm=round((rates[1] - rates[0]) / 2 * 1e6, 4),
                epoch_local_ns=round(epoch * 1e9),
                source="flash",
                reason="one flash or lamp alone, taken for the same" if len(pairs) == 1 else "",
            )
    return CameraTimes()


def _moments(flashes: Sequence[Flash], period_s: float, tolerance_s: float) -> Array:
    """Return the own times (combinations, flashes, 2) between which each flash happened.

    The combinations are all readout and exposure times that fit. With the readout R, the exposure E and a
    frame's time t in the middle of its middle row's exposure, a flash at T lights the rows from t + R (down -
    1/2) = T - E/2 to T + E/2.
    """
    readout = np.linspace(0, 1, READOUTS)[:, None] * period_s
    starts, ends = (
        np.stack([_range(getattr(of, side), readout[:, 0], tolerance_s) for of in flashes], axis=1)
        for side in ("start", "end")
    )
    # A lamp's edge is at the row with light during half of its exposure, whatever the exposure time.
    lasting = np.array([not of.step for of in flashes])
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
    place = edge.at_s + (0 if edge.hidden else readout_s * (edge.down - 0.5))
    if edge.hidden:
        half_width = half_width + np.maximum(edge.gap_s - readout_s, 0) / 2 + EDGE_ROWS * readout_s
    return np.stack([place - half_width, place + half_width], axis=-1)


def _lines(at: Array, lowest: Array, highest: Array) -> tuple[Range, Range] | tuple[None, None]:
    """Return the ranges of offset (at 0) and rate of lines from `lowest` to `highest` (combinations, n)."""
    drift = np.abs(at) * MAX_DRIFT_PPM * 1e-6
    low, high = (lowest - drift).max(1), (highest + drift).min(1)
    slow, fast = np.full(len(lowest), -MAX_DRIFT_PPM * 1e-6), np.full(len(lowest), MAX_DRIFT_PPM * 1e-6)
    for i in range(len(at)):
        for j in range(len(at)):
            if at[i] >= at[j]:
                continue
            apart = at[j] - at[i]
            slow = np.maximum(slow, (lowest[:, j] - highest[:, i]) / apart)
            fast = np.minimum(fast, (highest[:, j] - lowest[:, i]) / apart)
            if at[i] <= 0 <= at[j]:
                low = np.maximum(low, (lowest[:, i] * at[j] - lowest[:, j] * at[i]) / apart)
                high = np.minimum(high, (highest[:, i] * at[j] - highest[:, j] * at[i]) / apart)
    good = (low <= high) & (slow <= fast)
    if not good.any():
        return None, None
    return (float(low[good].min()), float(high[good].max())), (
        float(slow[good].min()),
        float(fast[good].max()),
    )
