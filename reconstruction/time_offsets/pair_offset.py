"""How late one camera of a session is against another, by all that moves before both.

A calibration that is off by a milliradian moves what crosses its lines by a time: what stands still mends
it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np

from capture_app.session.format.manifest import RowExposures, row_exposures
from reconstruction.calibration.rig import Rig
from reconstruction.common.geometry import Array, View
from reconstruction.common.point_tracking import track_there_and_back
from reconstruction.pairs import match_descriptors, match_features
from reconstruction.session.conditions import evenly_spread
from reconstruction.session.dataset import Dataset
from reconstruction.session.instants import choose_moving_instants
from reconstruction.time_offsets.crossings import (
    Crossings,
    OffsetFit,
    Path,
    StillErrors,
    epipolar_errors_px,
    find_crossings,
    fit_offset,
)

MAX_POINTS = 400
MAX_SIDE_PX = 960
"""Where what moves is larger, points are looked for in a smaller picture of it."""
MARGIN_PX = 16
"""Picture around what moves that is looked at, so that points at its edge are described too."""
MAX_DRIFT_PX = 0.5
"""A point followed to the neighbouring image and back must return to within this."""
WINDOW_PX = 15
MATCH_RATIO = 0.8
"""Greatest distance of a match against that of the second best."""
LEVELS = 4
"""Levels of the pyramid in which points are followed."""


@dataclass(frozen=True)
class MovingPoints:
    """Points of one image: `at` (n, 2) px, unit descriptors (n, 128), `before` and `after` (n, 2) px.

    The latter are the places in the image before and the one after, NaN where a point was not followed.
    """

    at: Array
    descriptors: Array
    before: Array
    after: Array


def find_moving_points(
    image: Array, movers: Array, before: Array | None, after: Array | None
) -> MovingPoints:
    """SIFT points (RootSIFT) of a grey image (uint8) on its movers (bool), followed by Lucas-Kanade.

    Descriptors are square roots of SIFT's, normalized to sum 1 (Arandjelovic and Zisserman 2012).
    """
    nothing = np.zeros((0, 2))
    if not movers.any():
        return MovingPoints(nothing, np.zeros((0, 128), np.float32), nothing, nothing)
    ys, xs = np.nonzero(movers)
    left, top = max(0, int(xs.min()) - MARGIN_PX), max(0, int(ys.min()) - MARGIN_PX)
    part = np.s_[top : int(ys.max()) + MARGIN_PX, left : int(xs.max()) + MARGIN_PX]
    small, allowed = np.ascontiguousarray(image[part]), np.ascontiguousarray(movers[part]).astype(np.uint8)
    scale = min(1.0, MAX_SIDE_PX / max(small.shape))
    if scale < 1:
        small = cv2.resize(small, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        allowed = cv2.resize(allowed, small.shape[::-1], interpolation=cv2.INTER_NEAREST)
    sift = cv2.SIFT.create(nfeatures=MAX_POINTS, contrastThreshold=0.01)
    keypoints, raw = sift.detectAndCompute(small, allowed)
    if raw is None:
        return MovingPoints(nothing, np.zeros((0, 128), np.float32), nothing, nothing)
    at = (np.array([point.pt for point in keypoints]) + 0.5) / scale - 0.5 + np.array([left, top])
    roots = np.sqrt(raw / np.maximum(raw.sum(1, keepdims=True), 1e-7)).astype(np.float32)
    return MovingPoints(at, roots, _follow(image, before, at), _follow(image, after, at))


def _follow(image: Array, other: Array | None, at: Array) -> Array:
    """Where points (n, 2) lie in another image; NaN where they do not return."""
    if other is None:
        return np.full_like(at, np.nan)
    there, drift = track_there_and_back(image, other, at, WINDOW_PX, LEVELS)
    return np.where((drift < MAX_DRIFT_PX)[:, None], there.astype(np.float64), np.nan)


LEAST_MATCHES = 60
"""Fewer of what stands still tell less than the calibration."""
FARTHEST_PX = 6.0
"""Matches that are further from their epipolar lines are wrong ones."""
PRIOR = np.array([5e-4, 5e-4, 5e-4, 1e-3, 1e-3])
"""What a calibration may be wrong by: the rotation, and the direction from camera to camera, rad."""
LEAST_SPREAD_PX = 0.15
STEP = 1e-5
ROUNDS = 8


def mend_pair(a: View, b: View, at_a: Array, at_b: Array) -> View:
    """The second view, turned and moved a little so that still matches (n, 2) px lie on their lines.

    Gauss-Newton with Cauchy weights and the prior; the distance between the cameras stays.
    """
    errors = epipolar_errors_px(a, b, at_a, at_b)
    near = np.abs(errors) < FARTHEST_PX
    if near.sum() < LEAST_MATCHES:
        return b
    at_a, at_b, change = at_a[near], at_b[near], np.zeros(5)
    for _ in range(ROUNDS):
        now = epipolar_errors_px(a, _changed(a, b, change), at_a, at_b)
        slopes = [
            (epipolar_errors_px(a, _changed(a, b, change + step), at_a, at_b) - now) / STEP
            for step in STEP * np.eye(5)
        ]
        jacobian = np.stack(slopes, axis=1)
        spread = max(LEAST_SPREAD_PX, 1.4826 * float(np.median(np.abs(now - np.median(now)))))
        weights = 1 / spread**2 / (1 + (now / (2 * spread)) ** 2)
        normal = jacobian.T @ (weights[:, None] * jacobian) + np.diag(1 / PRIOR**2)
        change = change - np.linalg.solve(normal, jacobian.T @ (weights * now) + change / PRIOR**2)
    return _changed(a, b, change)


def _changed(a: View, b: View, change: Array) -> View:
    """The second view after a rotation (3,) rad, its direction from the first changed by (2,) rad."""
    rotation = cv2.Rodrigues(change[:3])[0] @ b.rotation
    apart = b.centre - a.centre
    distance = float(np.linalg.norm(apart))
    direction = apart / distance
    beside = np.linalg.svd(direction[None])[2][1:]
    direction = direction + beside.T @ change[3:]
    centre = a.centre + distance * direction / np.linalg.norm(direction)
    return replace(b, rotation=rotation, translation=-rotation @ centre)


REACH_MS = 300.0
"""Offsets up to this are looked for."""
FARTHEST_PERIODS = 2.5
"""Points are not followed to an image further away than this."""
STILL_INSTANTS = 9
"""At so many, spread over the session, what stands still is looked at."""
MAX_FRAMES = 20
"""Frames to either side that are looked at, at most."""


Matched = tuple[int, Array, Array, Path]


@dataclass(frozen=True)
class RoughOffset:
    """About how late the second camera of a pair is, and by how much that may be wrong, ms."""

    offset_ms: float
    reach_ms: float


class PairOffsets:
    """Time offsets between cameras of a calibrated rig, each image's points found once."""

    def __init__(self, rig: Rig, *, all_moves: bool = False) -> None:
        """`all_moves`: nothing stands still before these cameras, as they move themselves."""
        self.rig = rig
        self.all_moves = all_moves
        self.dataset = rig.dataset
        self.reach_ms = min(REACH_MS, MAX_FRAMES * self.dataset.period_ns / 1e6)
        self._points = lru_cache(maxsize=None)(self._find_points)
        self._still_features = lru_cache(maxsize=STILL_INSTANTS)(rig.features)
        self._geometry = lru_cache(maxsize=None)(self._mend_geometry)

    def measure(
        self, first: str, second: str, max_instants: int | None = None, *, rough: RoughOffset | None = None
    ) -> OffsetFit:
        """How much later than its times say the second camera's images were taken, against the first's.

        At so many instants at most, those at which something moves before both; None = at all of the first's.
        `rough`: near which offset to look, instead of around none.
        """
        views = self.rig.views
        for name in (first, second):
            if name not in views:
                return OffsetFit(reason=f"{name} has no calibration")
        if np.linalg.norm(views[first].centre - views[second].centre) == 0:
            return OffsetFit(reason="both cameras stand at the same place")
        times = ImageTimes(self.dataset, (first, second))
        near = rough or RoughOffset(0.0, self.reach_ms)
        others = {
            other: times.at_ms(second, other) + near.offset_ms for other in self.dataset.instants(second)
        }
        asked: Sequence[int] = self.dataset.instants(first)
        if rough is not None:
            low, high = min(others.values(), default=0.0), max(others.values(), default=0.0)
            asked = [k for k in asked if low <= times.at_ms(first, k) <= high]
        elif max_instants is not None:
            asked = self.dataset.instants(first, second)
        if max_instants is not None:
            asked = self._spread(asked, (first, second) if rough is None else (first,), max_instants)
        found = [
            self._match(times, first, now, second, other)
            for now in asked
            for other, at_ms in others.items()
            if abs(at_ms - times.at_ms(first, now)) <= near.reach_ms
        ]
        at_a, at_b = self._still_matches(first, second)

        def fit(views: Mapping[str, View]) -> OffsetFit:
            pair = views[first], views[second]
            still = StillErrors.of(epipolar_errors_px(*pair, at_a, at_b)) if len(at_a) else StillErrors()
            crossings = Crossings.join([find_crossings(pair, *one) for one in found])
            return fit_offset(crossings.later(-near.offset_ms), still, self.dataset.period_ns / 1e6)

        mended = self._geometry(*sorted((first, second)))
        fitted = fit(mended)
        if any(mended[name] is not views[name] for name in mended):
            fitted = fitted.in_doubt_of(fit(views))
        return fitted.later(near.offset_ms)

    def _spread(self, instants: Sequence[int], cameras: Sequence[str], limit: int) -> Sequence[int]:
        """Some of the instants, those with motion before the cameras."""
        if self.all_moves or not instants:
            return evenly_spread(instants, limit)
        return choose_moving_instants(self.rig.motion, cameras, instants, limit)

    def _match(self, times: "ImageTimes", first: str, now: int, second: str, other: int) -> Matched:
        """What moves in both images: instant, px and ms in the first, path before the second."""
        here, there = self._points(first, now), self._points(second, other)
        a, b = match_descriptors(here.descriptors, there.descriptors, MATCH_RATIO)
        at_a = here.at[a]
        path = [there.before[b], there.at[b], there.after[b]]
        beside = self._neighbours(second, other)
        when = [
            np.full(len(at), np.nan) if k is None else times.of_rows_ms(second, k, at[:, 1])
            for k, at in zip((beside[0], other, beside[1]), path, strict=True)
        ]
        return now, at_a, times.of_rows_ms(first, now, at_a[:, 1]), Path(np.stack(path), np.stack(when))

    def _neighbours(self, camera: str, instant: int) -> tuple[int | None, int | None]:
        """The camera's own images before and after; what recordings without common times pair leaves gaps."""
        data, found = self.dataset, []
        for step in (-1, 1):
            near = (instant + step * k for k in range(1, 4))
            other = next((k for k in near if data.has_image(camera, k)), None)
            if other is not None:
                apart_ns = data.record(camera, other).leader_ns - data.record(camera, instant).leader_ns
                if abs(apart_ns) > FARTHEST_PERIODS * data.period_ns:
                    other = None
            found.append(other)
        return found[0], found[1]

    def _find_points(self, camera: str, instant: int) -> MovingPoints:
        data = self.dataset
        before, after = (
            None if k is None else data.grey(camera, k) for k in self._neighbours(camera, instant)
        )
        if self.all_moves:
            movers = np.ones(data.grey(camera, instant).shape, bool)
        else:
            movers = self.rig.motion.widened_movers(camera, instant)
        return find_moving_points(data.grey(camera, instant), movers, before, after)

    def _mend_geometry(self, first: str, second: str) -> dict[str, View]:
        """Both views by the rig's calibration, mended by what stands still."""
        a, b = self.rig.views[first], self.rig.views[second]
        at_a, at_b = self._still_matches(first, second)
        return {first: a, second: mend_pair(a, b, at_a, at_b) if len(at_a) else b}

    def _still_matches(self, first: str, second: str) -> tuple[Array, Array]:
        """Where both show what stands still, (n, 2) px each, at a few instants."""
        found = [(np.zeros((0, 2)), np.zeros((0, 2)))]
        every = range(len(self.dataset.instants_ns))
        for k in () if self.all_moves else evenly_spread(every, STILL_INSTANTS):
            points = self._still_features(k)
            if first in points and second in points:
                found.append(match_features(points[first], points[second]))
        at_a, at_b = (np.concatenate(of) for of in zip(*found, strict=True))
        return at_a, at_b


class ImageTimes:
    """When the rows of some cameras' images were taken by the session's record, ms since its first instant.

    The middle of each row's exposure where all of these cameras tell it, else the image's one time.
    """

    def __init__(self, dataset: Dataset, cameras: Sequence[str]) -> None:
        self.dataset = dataset
        self._epoch_ns = dataset.instants_ns[0]
        self._by_rows = all(
            self._rows(camera, instant) is not None
            for camera in cameras
            for instant in dataset.instants(camera)
        )

    def at_ms(self, camera: str, instant: int) -> float:
        """The image's one time."""
        return (self.dataset.record(camera, instant).leader_ns - self._epoch_ns) / 1e6

    def middle_ms(self, camera: str, instant: int) -> float:
        """The time of the image's middle row."""
        middle = self.dataset.size(camera)[1] / 2
        return float(self.of_rows_ms(camera, instant, np.array([middle]))[0])

    def of_rows_ms(self, camera: str, instant: int, rows: Array) -> Array:
        """The times of rows (n,), px from the top; NaN where there is no such image."""
        if not self.dataset.has_image(camera, instant):
            return np.full(len(rows), np.nan)
        known = self._rows(camera, instant) if self._by_rows else None
        if known is None:
            return np.full(len(rows), self.at_ms(camera, instant))
        start_ms = (known.middle_ns(0) - self._epoch_ns) / 1e6
        # Images that were made smaller have fewer rows than the camera read.
        row_ms = known.row_time_ns / 1e6 * known.rows / self.dataset.size(camera)[1]
        return np.asarray(start_ms + row_ms * rows)

    def _rows(self, camera: str, instant: int) -> RowExposures | None:
        dataset = self.dataset
        return row_exposures(dataset.session.camera(camera), dataset.record(camera, instant))
