"""Time offset of one camera of a session relative to another, from objects that move in front of both."""

from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial

import cv2
import numpy as np
from msgspec import structs

from capture_app.common.errors import BadInputError
from capture_app.session.exporting.descriptor_matches import match_descriptors
from reconstruction.common.geometry import Array, View, epipolar_errors_px
from reconstruction.common.image_matching import track_there_and_back
from reconstruction.common.worker_pool import computed_once
from reconstruction.scene.calibration.consistency import fit_one_plane
from reconstruction.scene.conditions import evenly_spaced
from reconstruction.scene.instant_choice import choose_moving_instants
from reconstruction.scene.moving_pixels import MIN_STILL, find_shifts, in_light_of, measure_camera_motion
from reconstruction.scene.pairs import FAINT_CONTRAST, detect_features, match_at_rest
from reconstruction.scene.scene import Scene
from reconstruction.time_offsets.camera_time import MAX_OFFSET_MS, ImageTimes
from reconstruction.time_offsets.crossings import (
    MAX_IN_MOTION_PX,
    TYPICAL_AT_REST_PX,
    Crossings,
    OffsetFit,
    Path,
    StillErrors,
    find_crossings,
    fit_offset,
    median_px,
    misfit,
    points_at_offset,
    still_errors,
)
from reconstruction.time_offsets.frame_jumps import BESIDE, image_change, place_step
from reconstruction.time_offsets.instant_votes import MIN_VOTES, Step
from reconstruction.time_offsets.outlines import Outlines, find_outlines, moves_evenly, similar_objects
from reconstruction.time_offsets.pair_geometry import (
    Correction,
    correct_views,
    other_calibrations,
)
from reconstruction.time_offsets.repetition import repetitions_ms
from reconstruction.time_offsets.rough_offset import (
    RoughOffset,
    equal_offsets,
    find_rough_offset,
    measure_activity,
)
from reconstruction.time_offsets.screens import find_screen
from reconstruction.time_offsets.single_images import repeated_images

MAX_DRIFT_PX = 0.5
"""Maximum distance from its start of a point tracked to the neighbouring image and back."""
MATCH_RATIO = 0.8
"""Maximum ratio of a match's distance to the second best's."""
DISAGREEING = 3.0
"""Standard deviations between two fits of an offset from which they contradict each other."""
MIN_REST = 0.3
"""Minimum fraction of a camera's instants between two shifts from which those alone are measured."""
UNDETERMINED = (
    "the calibration is a guess from points that lie in one plane, or far away, and that fit other poses as "
    "well: calibrate with a board"
)
GUESSED_IN_MOTION = (
    "the calibration is a guess from pictures of moving cameras, in which a delay looks like another place: "
    "calibrate with a board"
)
NEARLY_ALL, EVENLY = 0.7, 0.8
"""Minimum fraction of moving points that turn, and minimum ratio of a turn's speeds."""
MIN_CIRCLING_PX, MIN_ROTATION = 1.0, 0.05
"""Minimum motion of a point, and minimum turn (rad), from frame to frame."""


def _follow(image: Array, other: Array | None, at: Array) -> Array:
    """Track points (n, 2) to another image; NaN where they do not return."""
    if other is None or not len(at):
        return np.full_like(at, np.nan)
    there, drift = track_there_and_back(image, other, at, 15, 4)
    return np.where((drift < MAX_DRIFT_PX)[:, None], there.astype(np.float64), np.nan)


Image = tuple[str, int]
"""A camera and an instant."""
MovingPoints = tuple[Array, Array]
"""Unit descriptors (n, 128) of points; positions (3, n, 2) px in the previous image, their own and the next.

Positions are NaN where tracking failed."""
MovingMatches = tuple[Array, Array, Array]
"""Matches (n, 2) px in two cameras at the same time, and their speeds (n, 2) in the second, px/ms."""


class PairOffsets:
    """Time offsets between cameras of a calibrated rig; the points of each image are detected once."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.dataset = scene.dataset
        # Offsets of at most twenty frames are searched for.
        self.max_offset_ms = min(MAX_OFFSET_MS, 20 * self.dataset.period_ns / 1e6)
        # About 150 images of all cameras together: more cameras mean fewer instants of each pair, 6 to 48.
        self.max_instants = int(np.clip(150 // len(self.dataset.cameras), 6, 48))
        self._points = computed_once(self._find_points)
        self._outlines = computed_once(self._find_outlines)
        self._stays = computed_once(self._find_staying)
        self._motion = computed_once(partial(measure_camera_motion, scene.dataset))
        self._rest = computed_once(self._find_rest)
        self._screen = computed_once(partial(find_screen, scene.dataset))
        self._repetitions = computed_once(partial(repetitions_ms, scene.dataset))
        self.repeated = computed_once(partial(repeated_images, scene.dataset))
        self._activity = computed_once(partial(measure_activity, scene.dataset))
        # A comparison's pair is also one of its rig's.
        self.measure = computed_once(self._measure)
        self.measure_anywhere = computed_once(self._measure_anywhere)

    def moving(self, cameras: Iterable[str]) -> dict[str, tuple[float, float]]:
        """Return the motion (px, in ms) of cameras that move while they record, without static background."""
        return {
            name: motion[1:]
            for name in cameras
            if (motion := self._motion(name)) is not None and motion[0] < MIN_STILL
            if not self._rest(name)[1]
        }

    def _find_rest(self, camera: str) -> tuple[Sequence[int], str]:
        """Return the longest part of a camera's instants without a shift, and the shift in words.

        All instants and no words if it was not moved, or if that part is short: then it moves all the time.
        The images beside a shift show no motion either, as points are tracked over it.
        """
        there = self.dataset.instants(camera)
        shifts, begin, parts = find_shifts(self.dataset, camera), 0, []
        for last, first, _ in [*shifts, (there[-1] + 1, 0, 0.0)]:
            parts.append([k for k in there if begin <= k < last])
            begin = first + 1
        longest = max(parts, key=len)
        if not shifts or len(longest) < MIN_REST * len(there):
            return there, ""
        places = " and ".join(f"by {px:.1f} pixels before instant {first}" for _, first, px in shifts)
        return longest, (
            f"{camera} itself was moved {places}: only instants {longest[0]} to {longest[-1]} are measured"
        )

    def _measure_anywhere(self, first: str, second: str) -> OffsetFit:
        """Measure as `measure` does, and where what moves may agree as well.

        That is whole periods of its parts away or, of recordings without common times, their whole overlap.
        """
        if not self.dataset.unsynchronized:
            return self._measure_periods(first, second)
        rough = find_rough_offset(
            partial(self.measure, first, second),
            self._activity(first),
            self._activity(second),
            max(map(self._repetitions, (first, second)))[0],
            self.dataset.period_ns / 1e6,
        )
        if isinstance(rough, str):
            return OffsetFit(reason=rough)
        # Clocks' rates are measured too, by more instants than offsets alone.
        fit = self.measure(first, second, 60, rough=rough)
        if fit.change.steps:
            return OffsetFit(
                reason=f"{fit.change.describe(second, first)}: it dropped or repeated frames", moved=fit.moved
            )
        return fit

    def _measure_periods(self, first: str, second: str) -> OffsetFit:
        """Measure at the offset that most points agree on, up to two periods of any part from `measure`'s.

        Of two discs, each alone fits at all of its own periods, as a disc does beside somebody who walks.
        """
        both, period_ms, fit = (first, second), self.dataset.period_ns / 1e6, self.measure(first, second)
        whole_ms, *lags_ms = max(map(self._repetitions, both))
        if fit.offset_ms is None or whole_ms or not lags_ms:
            return fit
        data = self.dataset
        equal, _ = equal_offsets(
            partial(self.measure, *both),
            [fit.offset_ms + n * lag for lag in lags_ms for n in (-2, -1, 0, 1, 2)],
            (),
            [np.array([data.record(name, k).leader_ns for k in data.instants(name)]) / 1e6 for name in both],
            period_ms,
        )
        nearest_ms = min(equal, key=abs, default=fit.offset_ms)
        if abs(nearest_ms - fit.offset_ms) > period_ms:
            fit = replace(self.measure(*both, rough=(nearest_ms, 1.5 * period_ms)), repeats_ms=0.0)
        spans_ms = (abs(ms - nearest_ms) for ms in equal if ms != nearest_ms)
        return replace(fit, repeats_ms=min(spans_ms, default=fit.repeats_ms))

    def _measure(
        self,
        first: str,
        second: str,
        limit: int | None = None,
        *,
        rough: RoughOffset | None = None,
        beside_ms: float | None = None,
    ) -> OffsetFit:
        """Measure the second camera's delay beyond its recorded times, relative to the first.

        Uses at most `limit` instants (None: the default) at which something moves in front of both cameras.
        `rough` is an approximate offset to search around, instead of 0; `beside_ms` is another one, at which
        the second camera must have images of the same instants, too.
        """
        views = self.scene.views
        if reason := self._why_unmeasurable(first, second):
            guessed = reason in (UNDETERMINED, GUESSED_IN_MOTION)
            return OffsetFit(reason=reason, misfit_px=0.0 if guessed else None)
        times = ImageTimes(self.dataset, (first, second))
        near_ms, max_offset_ms = rough or (0.0, self.max_offset_ms)
        others = {
            other: times.at_ms(second, other) + near_ms
            for other in self._rest(second)[0]
            if other not in self.repeated(second)
        }
        all_moves = bool(self.moving((first, second)))
        cameras = (first, second) if rough is None else (first,)
        rest = set.intersection(*({*self._rest(camera)[0]} for camera in cameras))
        asked = tuple(
            k for k in self.dataset.instants(*cameras) if k in rest and k not in self.repeated(first)
        )
        if rough is not None:
            low, high = min(others.values(), default=0.0), max(others.values(), default=0.0)
            apart = 0.0 if beside_ms is None else beside_ms - near_ms
            low, high = low + max(0.0, apart), high + min(0.0, apart)
            asked = tuple(k for k in asked if low <= times.at_ms(first, k) <= high)
        limit = limit or self.max_instants
        chosen = (
            evenly_spaced(asked, limit)
            if all_moves or not asked
            else choose_moving_instants(self.scene.motion, cameras, asked, limit)
        )

        def apart_ms(instants: Sequence[int]) -> dict[tuple[int, int], float]:
            return {
                (now, other): at_ms - times.at_ms(first, now)
                for now in instants
                for other, at_ms in others.items()
            }

        paths = partial(self._paths, times, (first, second), all_moves)
        period_ms = self.dataset.period_ns / 1e6

        def cross(pair: tuple[View, View], instants: Sequence[int] = chosen) -> Crossings:
            clusters = [
                find_crossings(pair, images, *paths(images))
                for images, ms in apart_ms(instants).items()
                if abs(ms) <= max_offset_ms
            ]
            return Crossings.join(clusters).later(-near_ms)

        def in_motion(offset_ms: float) -> MovingMatches:
            same = [images for images, ms in apart_ms(chosen).items() if abs(ms + offset_ms) <= period_ms / 2]
            parts = [points_at_offset(*paths(images)[0], near_ms + offset_ms) for images in same]
            at_a, at_b, speeds = zip((np.zeros((0, 2)),) * 3, *parts, strict=True)
            return np.concatenate(at_a), np.concatenate(at_b), np.concatenate(speeds)

        pair = views[first], views[second]
        if all_moves:
            return fit_in_motion(pair, period_ms, cross, in_motion).later(near_ms).examined_at(chosen)
        at_rest = self._still_matches(first, second)
        pair, still, recorded_px = _correct_at_rest(pair, *at_rest)
        crossings = cross(pair)
        fit = fit_offset(crossings, still, period_ms, recorded_px)
        # A long take is measured at some instants only: those around a step place it.
        for _ in range(3):
            around = [k for k in asked if any(step.earliest <= k < step.latest for step in fit.change.steps)]
            if not (more := evenly_spaced([k for k in around if k not in chosen], 6)):
                break
            chosen = [*chosen, *more]
            crossings = Crossings.join((crossings, cross(pair, more)))
            fit = fit_offset(crossings, still, period_ms, recorded_px)
        if fit.offset_ms is not None and self.scene.lenses.is_doubtful:
            fit = fit.under(
                [
                    fit_offset(cross(lenses, chosen), still_errors(lenses, *at_rest), period_ms)
                    for lenses in other_calibrations(pair, *at_rest)
                ]
            )
        fit = self._limited(fit.later(near_ms).examined_at(chosen), (first, second))
        return self._placed(fit, (first, second))

    def _why_unmeasurable(self, first: str, second: str) -> str:
        """Return why the calibration shows no offset between two cameras; empty if it does."""
        views = self.scene.views
        if missing := [name for name in (first, second) if name not in views]:
            return f"{missing[0]} has no calibration"
        if empty := [name for name in (first, second) if not self.dataset.instants(name)]:
            return f"{empty[0]} has no images"
        if np.linalg.norm(views[first].centre - views[second].centre) == 0:
            return "both cameras are at the same place"
        if not self.scene.lenses.is_doubtful:
            return ""
        if self.moving((first, second)):
            return GUESSED_IN_MOTION
        return UNDETERMINED if fit_one_plane(*self._still_matches(first, second)) else ""

    def _limited(self, fit: OffsetFit, cameras: tuple[str, str]) -> OffsetFit:
        """Return a fit with the shifts of cameras that were moved, and with the period of what repeats."""
        moved = {camera: text for camera in cameras if (text := self._rest(camera)[1])}
        screens = tuple(camera for camera in cameras if self._screen(camera).any())
        if fit.offset_ms is None:
            beside = f" beside the screen in the pictures of {' and '.join(screens)}" if screens else ""
            return replace(fit, moved=moved, reason=fit.reason + beside)
        repeats_ms = max(map(self._repetitions, cameras))[0] or self._turning_ms(cameras[0], fit)
        return replace(fit, moved=moved, screens=screens, repeats_ms=repeats_ms)

    def _turning_ms(self, camera: str, fit: OffsetFit) -> float:
        """Return the time of a whole turn if nearly all that moves turns evenly; 0 if not.

        A take of less than a turn and a half does not show that the motion repeats. The eigenvalues of the
        points' affine motion from an image to the next are a turn's, also seen from aside.
        """
        turns, seen = [], [one.instant for one in fit.instants]
        # At five instants.
        for before in evenly_spaced([k for k in seen if self.dataset.has_image(camera, k + 1)], 5):
            images = [self._points(camera, instant, False) for instant in (before, before + 1)]
            matched = match_descriptors(images[0][0], images[1][0], MATCH_RATIO)
            at, after = (positions[1][chosen] for (_, positions), chosen in zip(images, matched, strict=True))
            moves = np.linalg.norm(after - at, axis=1) > MIN_CIRCLING_PX
            if moves.sum() < MIN_VOTES:
                return 0.0
            motion, turning = cv2.estimateAffine2D(at[moves], after[moves])
            if motion is None or turning.mean() < NEARLY_ALL:
                return 0.0
            turns.append(float(np.abs(np.angle(np.linalg.eigvals(motion[:, :2])[0]))))
        is_even = bool(turns) and min(turns) > max(MIN_ROTATION, EVENLY * max(turns))
        return 2 * np.pi / float(np.median(turns)) * self.dataset.period_ns / 1e6 if is_even else 0.0

    def _placed(self, fit: OffsetFit, cameras: tuple[str, str]) -> OffsetFit:
        """Return a fit with its steps placed by what moves in each camera's own images.

        Unknown if the offset before a step has no images after it, or the other one none before it: what
        repeats agrees at another offset there.
        """
        if fit.offset_ms is None or not fit.change.steps or self.dataset.unsynchronized:
            # Images of the same instant may be of any two times.
            return fit
        shift, steps = round(fit.offset_ms * 1e6 / self.dataset.period_ns), list[Step]()
        story, there = fit.change.describe(*cameras[::-1]), self.dataset.instants(cameras[0])
        places = [there[0], *(step.instant for step in fit.change.steps), there[-1] + 1]
        for step, begin, end in zip(fit.change.steps, places, places[2:], strict=False):
            after, before = range(step.instant, end), range(begin, step.instant)
            for instants, frames in ((after, shift), (before, shift + step.frames)):
                if not any(self.dataset.has_image(cameras[1], k - frames) for k in instants):
                    return OffsetFit(
                        reason=f"{story} by what moves, but no images there could show otherwise"
                    )
            around = range(step.earliest - 2 * BESIDE, step.latest + 2 * BESIDE + 1)
            first, second = (self._changes(camera, around) for camera in cameras)
            steps.append(place_step(step, first, second, shift))
            shift += step.frames
        if not all(step.frames for step in steps):
            return OffsetFit(reason=f"{story} by what moves, but its own pictures show no such gap")
        return replace(fit, change=structs.replace(fit.change, steps=tuple(steps)))

    def _changes(self, camera: str, instants: Iterable[int]) -> dict[int, float]:
        """Return the `image_change` at instants that follow another image."""
        images = {}
        for k in instants:
            if self.dataset.has_image(camera, k):
                with suppress(BadInputError):
                    images[k] = self.dataset.grey(camera, k)
        return {k: image_change(images[k - 1], image) for k, image in images.items() if k - 1 in images}

    def _paths(
        self, times: ImageTimes, cameras: tuple[str, str], all_moves: bool, instants: tuple[int, int]
    ) -> tuple[tuple[Path, Path], Array, Array]:
        """Return the paths of what moves in both images, with `counts` and `shared_px` as in `Crossings`."""
        a, b = zip(cameras, instants, strict=True)
        here, there = self._points(*a, all_moves), self._points(*b, all_moves)
        corners = match_descriptors(here[0], there[0], MATCH_RATIO)
        objects = similar_objects(self._outlines(*a), self._outlines(*b))
        if all_moves:
            objects = np.zeros(0, int), np.zeros(0, int)
        first = self._path(times, a, here[1][:, corners[0]], objects[0])
        second = self._path(times, b, there[1][:, corners[1]], objects[1])
        # An object's whole outline determines its centre.
        counts = np.concatenate([np.ones(len(corners[0])), np.full(len(objects[0]), 4.0)])
        errors_px = np.hypot(
            self._outlines(*a).errors_px[objects[0]], self._outlines(*b).errors_px[objects[1]]
        )
        return (first, second), counts, np.concatenate([np.zeros(len(corners[0])), errors_px])

    def _path(self, times: ImageTimes, image: Image, corners: Array, objects: Array) -> Path:
        """Return the positions of corners (3, n, 2) and selected objects before, at and after an image."""
        outlines = self._outlines(*image)
        before, after = self._neighbours(*image)
        path, when = [], []
        for k, at in zip((before, image[1], after), corners, strict=True):
            there = None if k is None else self._outlines(image[0], k)
            middles = outlines.at if k == image[1] else outlines.nearest(there)
            path.append(np.concatenate([at, middles[objects]]))
            when.append(times.of_rows_ms(image[0], k, path[-1][:, 1]))
        whole, times_ms, count = np.stack(path), np.stack(when), corners.shape[1]
        jumps = count + np.flatnonzero(~moves_evenly(whole[:, count:], times_ms[:, count:]))
        whole[::2, jumps] = np.nan
        return whole, times_ms

    def _neighbours(self, camera: str, instant: int) -> tuple[int | None, int | None]:
        """Return the camera's previous and next image; recordings paired without common times have gaps."""
        data = self.dataset

        def near(k: int) -> bool:
            """Return whether there is an image, near enough in time for tracking."""
            if not data.has_image(camera, k) or k in self.repeated(camera):
                return False
            apart_ns = data.record(camera, k).leader_ns - data.record(camera, instant).leader_ns
            return abs(apart_ns) <= 2.5 * data.period_ns

        before = next(filter(near, range(instant - 1, instant - 4, -1)), None)
        return before, next(filter(near, range(instant + 1, instant + 4)), None)

    def _find_points(self, camera: str, instant: int, all_moves: bool) -> MovingPoints:
        """Detect points in the moving regions of an image, and track them by Lucas-Kanade.

        Descriptors are square roots of SIFT's, normalized to sum 1 (Arandjelovic and Zisserman 2012).
        """
        data = self.dataset
        image = data.grey(camera, instant)
        moving = np.ones(image.shape, bool) if all_moves else self._bodies(camera, instant)
        left, top, wide, tall = cv2.boundingRect(moving.astype(np.uint8))
        # Points at the edge of what moves get descriptors too.
        margin_px = 16
        corner = max(0, left - margin_px), max(0, top - margin_px)
        part = np.s_[corner[1] : top + tall - 1 + margin_px, corner[0] : left + wide - 1 + margin_px]
        # Larger regions than 960 px are reduced before points are detected in them.
        points = detect_features(image[part], 960, 400, FAINT_CONTRAST, allowed=moving[part])
        at, raw = points.positions + corner, points.descriptors
        roots = np.sqrt(raw / np.maximum(raw.sum(1, keepdims=True), 1e-7))
        # Points are lost in a lamp's flicker and in bands of mains light.
        others = (
            None if k is None else in_light_of(image, data.grey(camera, k)).astype(np.uint8)
            for k in self._neighbours(camera, instant)
        )
        before, after = (_follow(image, other, at) for other in others)
        return roots, np.stack([before, at, after])

    def _find_outlines(self, camera: str, instant: int) -> Outlines:
        motion, image = self.scene.motion, self.dataset.grey(camera, instant)
        return find_outlines(image, motion.background(camera), self._bodies(camera, instant))

    def _bodies(self, camera: str, instant: int) -> Array:
        """Return the moving pixels that show no screen, and a margin around them (bool)."""
        return np.asarray(self.scene.motion.widened_moving(camera, instant) & ~self._screen(camera))

    def _still_matches(self, first: str, second: str) -> tuple[Array, Array]:
        """Return matched static points, (n, 2) px in each camera."""
        matches = [(np.zeros((0, 2)), np.zeros((0, 2)))]
        # At nine instants, spread over the session.
        some = evenly_spaced(sorted({*self._rest(first)[0]} & {*self._rest(second)[0]}), 9)
        half = len(some) // 2
        for k, other in zip(some, some[half:] + some[:half], strict=True):
            a, b = (self.scene.features.at_rest(k)[name] for name in (first, second))
            of_a, of_b = match_at_rest(a, b)
            stays = self._stays(first, k, other)[of_a] & self._stays(second, k, other)[of_b]
            matches.append((a.positions[of_a[stays]], b.positions[of_b[stays]]))
        at_a, at_b = map(np.concatenate, zip(*matches, strict=True))
        return at_a, at_b

    def _find_staying(self, camera: str, instant: int, other: int) -> Array:
        """Return which of an image's features are at the same place in another image of the camera (bool)."""
        at = self.scene.features.at_rest(instant)[camera].positions
        there = _follow(self.dataset.grey(camera, instant), self.dataset.grey(camera, other), at)
        with np.errstate(invalid="ignore"):
            return np.asarray(np.linalg.norm(there - at, axis=1) < MAX_DRIFT_PX)


def _correct_at_rest(
    pair: tuple[View, View], at_a: Array, at_b: Array
) -> tuple[tuple[View, View], StillErrors, float]:
    """Correct a calibration by static matches if it does not fit them.

    Returns the views, the errors of the matches, and their median, px, with the recorded calibration.
    """
    still = still_errors(pair, at_a, at_b)
    recorded_px = median_px(still[0])
    if recorded_px > TYPICAL_AT_REST_PX and (correction := correct_views(pair, at_a, at_b)) is not None:
        return correction[0], still_errors(correction[0], at_a, at_b), recorded_px
    return pair, still, recorded_px


def fit_in_motion(
    pair: tuple[View, View],
    period_ms: float,
    cross: Callable[[tuple[View, View]], Crossings],
    in_motion: Callable[[float], MovingMatches],
) -> OffsetFit:
    """Fit the offset of cameras that move, together with the calibration if that does not fit the matches.

    `in_motion` returns the matches at an offset, ms.
    """
    matches = in_motion(0.0)
    nothing = still_errors(pair, matches[0][:0], matches[1][:0])
    recorded_px = _off_px(pair, matches)
    fits = recorded_px <= TYPICAL_AT_REST_PX
    correction = None if fits else _correct_in_motion(pair, period_ms, in_motion, 0.0)
    if correction is None:
        fit = fit_offset(cross(pair), nothing, period_ms)
        if fit.offset_ms is None:
            return fit
        matches = in_motion(fit.offset_ms)
        if (left_px := _off_px(pair, matches)) <= MAX_IN_MOTION_PX:
            if fits:
                return fit
            # More than a frame late, or another calibration.
            correction = _correct_in_motion(pair, period_ms, in_motion, fit.offset_ms)
        if correction is None:
            return misfit(len(matches[0]), "matched points", max(left_px, recorded_px))
    views, late_ms, sd_ms = correction
    fit = fit_offset(cross(views), nothing, period_ms, _off_px(pair, in_motion(late_ms)))
    if fit.offset_ms is None:
        return fit
    sd_ms = float(np.hypot(fit.sd_ms or 0.0, sd_ms))
    if abs(fit.offset_ms - late_ms) > DISAGREEING * sd_ms:
        return OffsetFit(reason="the moving points do not agree on one offset")
    return replace(fit, sd_ms=sd_ms)


def _correct_in_motion(
    pair: tuple[View, View],
    period_ms: float,
    in_motion: Callable[[float], MovingMatches],
    near_ms: float,
) -> Correction | None:
    """Correct a calibration and the offset, starting at `near_ms`; None if that does not converge."""
    for _ in range(4):
        if (geometry := correct_views(pair, *in_motion(near_ms), period_ms)) is None:
            break
        views, late_ms, sd_ms = geometry
        near_ms += late_ms
        if abs(late_ms) < period_ms / 2:
            return views, near_ms, sd_ms
    return None


def _off_px(pair: tuple[View, View], matches: MovingMatches) -> float:
    return median_px(epipolar_errors_px(*pair, *matches[:2])) if len(matches[0]) else 0.0
