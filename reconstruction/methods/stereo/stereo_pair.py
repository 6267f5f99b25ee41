"""Dense depth of a rectified pair, its disparity range, and epipolar errors of matches.

Both views must agree on a surface. Filling continues the surfaces behind into what only one view sees.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import cv2
import numpy as np

from capture_app.session.format.lens import OUTSIDE
from reconstruction.common.geometry import Array, View
from reconstruction.common.image_matching import gain_and_bias_of_shades, match_brightness, noise_level
from reconstruction.common.memory import memory_budget
from reconstruction.methods.stereo.matching import (
    MAX_GREY_DIFFERENCE,
    MAX_LEFT_RIGHT_PX,
    fill_small_holes,
    match_rectified,
    match_rectified_back,
    matching_bytes,
    refine_disparity,
    residual_displacement,
    same_brightness,
    warp_by_disparity,
    window_correlation,
)
from reconstruction.scene.pairs import canvas_bounds, rectifying_rotations

STEP = 16
"""Distance over which slopes are measured, px."""
WINDOW = 61
"""Side of the window over which slopes are averaged, px."""
MAX_CHANGE = 3.0
"""Maximum change over one step, px; a larger change is an edge, not a slope."""
SAME_GAIN, SAME_BIAS = 0.05, 4.0
"""Brightness difference (factor, grey levels) above which images are equalized and matched again."""
MAX_RESIDUAL_PX = 0.7
"""Displacement left after warping, also between rows, up to which `compute_depth` accepts a match.

At 0.8, a late ball that has moved 3.5 px across the rows has a depth on 21 % of its pixels, at 0.7 on none.
"""
ACCURACY_PX = 0.25
"""Accuracy of a disparity: a smaller one has no finite depth, only a least one."""
MIN_ISLAND_PX = 60
"""Smaller islands of depth are dropped."""
MIN_AGREEMENT = 0.35
"""Minimum fraction of textured pixels on whose coarse disparity both directions agree.

Views of the same scene reach 0.55 to 0.75, unrelated noise 0.27.
"""
MIN_CORRELATION = 0.7
"""Minimum correlation of textured pixels that vote for the disparity range."""
MIN_PIXELS = 30
"""Minimum number of pixels for a measurement."""
PATCH_PX = 21
ROWS_PX = 28
"""Search range of a patch above and below its row, px."""
LIKENESS = 0.75


def fill_holes(disparity: Array) -> Array:
    """Fill every hole of a disparity (float32 height x width, px, NaN = none); 0 if nothing is known.

    Pixels that only one view sees are behind the object that hides them from the other. A hole therefore
    continues the farther of the surfaces to its left and right (Hirschmueller 2008), along their slope. A
    median filter follows.
    """
    known = np.isfinite(disparity)
    if not (rows := np.flatnonzero(known.any(axis=1))).size:
        return np.zeros_like(disparity)
    width = disparity.shape[1]
    columns = np.arange(width, dtype=np.int32)
    left = np.maximum.accumulate(np.where(known, columns, -1), axis=1)
    right = np.minimum.accumulate(np.where(known, columns, width)[:, ::-1], axis=1)[:, ::-1]
    slope = _mean_slope(disparity)
    places = np.stack([left, right]).clip(0, width - 1)
    there = np.stack([left >= 0, right < width])
    nearest = np.where(there, np.take_along_axis(disparity[None], places, 2), np.inf)
    continued = nearest + np.take_along_axis(slope[None], places, 2) * (columns - places)
    behind = np.where(nearest[0] <= nearest[1], *continued)
    # An empty row takes the values of the nearest row with any.
    behind = behind[rows[np.abs(np.arange(len(behind))[:, None] - rows).argmin(axis=1)]]
    return np.where(known, disparity, cv2.medianBlur(np.maximum(behind, 0).astype(np.float32), 5))


def _mean_slope(disparity: Array) -> Array:
    """Return the change of the disparity per pixel along the row, averaged around each pixel; 0 = unknown."""
    change = disparity[:, STEP:] - disparity[:, :-STEP]
    gentle = np.abs(change) < MAX_CHANGE
    sums = np.zeros((2, *disparity.shape), np.float32)
    middle = slice(STEP // 2, STEP // 2 + change.shape[1])
    sums[0, :, middle] = np.where(gentle, change / STEP, 0)
    sums[1, :, middle] = gentle
    total, count = (cv2.blur(one, (WINDOW, WINDOW)) for one in sums)
    return np.asarray(total / np.maximum(count, 0.05))


@dataclass(frozen=True)
class Rectification:
    """A pair rotated onto one common image plane, whose rows are parallel to the baseline.

    A point at depth z (in the rectified frame, calibration's unit) is `focal * baseline / z` px further left
    in the other view than in the reference. If the other camera is on the opposite side, both images are
    mirrored (`mirror`), so that the sign is always positive. `left` and `top` are the coordinates of the
    canvas's first pixel relative to the common principal point.
    """

    views: tuple[View, View]
    rotations: tuple[Array, Array]
    focal: float
    baseline: float
    left: float
    top: float
    width: int
    height: int
    mirror: bool

    def remap(self, image: Array, *, other: bool = False, nearest: bool = False) -> tuple[Array, Array]:
        """Return the image on the canvas, and the canvas pixels that it covers (bool)."""
        xs, ys, seen = self._canvases[other]
        return cv2.remap(
            image,
            xs,
            ys,
            cv2.INTER_NEAREST if nearest else cv2.INTER_LINEAR,
            # Windows across the border match better than with a black frame.
            borderMode=cv2.BORDER_REPLICATE,
        ), seen

    def project(self, rays: Array, *, other: bool = False) -> Array:
        """Return canvas pixels (n, 2) of directions (n, 3) in one of the two camera frames."""
        turned = rays @ self.rotations[other].T
        scale, shift = np.diagonal(self._projection)[:2], self._projection[:2, 2]
        return np.asarray(turned[:, :2] / turned[:, 2:] * scale + shift)

    def depth(self, disparity: Array) -> Array:
        """Return depth in the reference's pixels (height x width, 0 = none) from the canvas's disparity."""
        shift = self.to_reference(np.nan_to_num(disparity).astype(np.float32))
        near = shift > 0
        rectified = np.where(near, self.focal * self.baseline / np.where(near, shift, 1.0), 0.0)
        return np.asarray(rectified / self._reference_pixels[2], np.float32)

    def to_reference(self, canvas: Array) -> Array:
        """Return the canvas's values (nearest) in the reference view's pixels; 0 outside the canvas."""
        xs, ys, _ = self._reference_pixels
        return np.asarray(cv2.remap(canvas, xs, ys, cv2.INTER_NEAREST, borderValue=(0.0,)))

    @cached_property
    def _canvases(self) -> list[tuple[Array, Array, Array]]:
        """Each view's pixel for each canvas pixel (x, y: float32), and the covered pixels (bool)."""
        votes_found = []
        for other, (view, rotation) in enumerate(zip(self.views, self.rotations, strict=True)):
            xs, ys = view.lens.maps((self.width, self.height), self._projection, rotation)
            outline = self.project(view.rays(view.border()), other=bool(other))
            seen = np.zeros((self.height, self.width), np.uint8)
            cv2.fillPoly(seen, [np.round(outline).astype(np.int32)], 1)
            votes_found.append((xs, ys, cv2.erode(seen, np.ones((3, 3), np.uint8)) > 0))
        return votes_found

    @cached_property
    def _reference_pixels(self) -> tuple[Array, Array, Array]:
        """Canvas pixel for each reference pixel (x, y), and its ray's z on the canvas; float32."""
        view, rotation = self.views[0], self.rotations[0]
        where = cv2.undistortPoints(
            view.grid().astype(np.float32).reshape(-1, 1, 2),
            view.matrix,
            view.distortion,
            R=rotation,
            P=self._projection,
        )
        xs, ys = np.ascontiguousarray(where.reshape(view.height, view.width, 2).transpose(2, 0, 1))
        xs[~view.lens.known(view.grid()).reshape(xs.shape)] = OUTSIDE
        # With z = 1 on the canvas, the ray's z in the view's own frame is linear in the canvas's pixels.
        right, down, ahead = map(float, rotation[:, 2] / (self._projection[0, 0], self.focal, 1.0))
        own = right * (xs + np.float32(self.left)) + down * (ys + np.float32(self.top)) + ahead
        return xs, ys, 1 / own

    @cached_property
    def _projection(self) -> Array:
        across = -self.focal if self.mirror else self.focal
        return np.array([[across, 0, -self.left], [0, self.focal, -self.top], [0, 0, 1.0]])


def rectify(
    reference: View, other: View, disparities: tuple[float, float], scale: float = 1.0
) -> Rectification:
    """Return the pair's rectification, wide enough for these disparities (min, max; px at scale 1).

    The canvas contains the whole reference view and the area of its matches in the other view. `scale` sets
    its size relative to the reference's own resolution.

    Raises:
        ValueError: the two views cannot be rectified; see `canvas_bounds`.
    """
    low, high = canvas_bounds(reference, other)
    reference_rotation, other_rotation, length, mirror = rectifying_rotations(reference, other)
    if mirror:
        low, high = np.array([-high[0], low[1]]), np.array([-low[0], high[1]])
    low, high = low * scale, high * scale
    # The canvas's pixels are the reference's own where nothing is turned: a rectified pair is not resampled.
    phase = (reference.matrix[:2, 2] * scale * (1.0 if mirror else -1.0, -1.0)) % 1
    left = np.floor(low[0] - max(disparities[1] * scale, 0.0) - phase[0]) + phase[0] - 1
    right = np.ceil(high[0] - min(disparities[0] * scale, 0.0)) + 1
    top, bottom = np.floor(low[1] - phase[1]) + phase[1] - 1, np.ceil(high[1]) + 1
    return Rectification(
        (reference, other),
        (reference_rotation, other_rotation),
        focal=reference.focal * scale,
        baseline=length,
        left=float(left),
        top=float(top),
        width=int(np.ceil(right - left)) + 1,
        height=int(np.ceil(bottom - top)) + 1,
        mirror=mirror,
    )


class DepthMap(NamedTuple):
    """Depth of one pair on the reference view's pixels.

    `depth` (height x width) is in the calibration's unit, 0 = none or rejected. `difference` is in grey
    levels between the reference and the other view, warped by the depth before the checks (NaN = none).
    """

    depth: Array
    difference: Array


class FilledDepthMap(NamedTuple):
    """Depth as in `DepthMap`, and with a value for every pixel; holes are filled from the background."""

    depth: Array
    filled: Array
    confidence: Array
    """Confidence, 0 (rejected) to 1: half from the agreement of both directions, half from similarity."""


class _Match(NamedTuple):
    """Match on the canvas: images, disparities of both directions (px), and what the checks need."""

    reference: Array
    other: Array
    forward: Array
    backward: Array
    left_right: Array
    """Difference between both directions, px."""
    difference: Array
    """Difference of grey levels after warping by the forward match."""
    surface: Array
    """Refined disparity where both directions agree and both images look alike; else NaN."""
    displacement: Array
    """Displacement left after warping by the forward match, px."""

    def checked(self) -> Array:
        """Return the surface where the images look alike, nothing is displaced, and depth is finite."""
        disparity = self.surface
        warped = warp_by_disparity(self.other, disparity)
        there = np.isfinite(warped) & (disparity >= ACCURACY_PX)
        reference = self.reference.astype(np.float32)
        good = there & (self.displacement <= MAX_RESIDUAL_PX)
        good &= same_brightness(reference, np.where(there, warped, reference))
        return np.where(_without_islands(good, disparity), disparity, np.nan)


class StereoPair:
    """Depth from one calibrated pair; all that does not depend on the images is computed in advance."""

    def __init__(self, reference: View, other: View, disparities: tuple[float, float]) -> None:
        """Prepare matching; the disparity range (px) from `find_disparity_range` is fixed for all conditions.

        If the range and the canvas exceed the memory budget, the pair is matched at a smaller scale.

        Raises:
            ValueError: the two views cannot be rectified.
        """
        low, high = max(0, int(np.floor(disparities[0]))), disparities[1]
        bare = rectify(reference, other, (low, high))
        # The rest is for images and maps.
        self.scale = memory_budget().fit_scale(
            f"depth of a pair ({bare.width}x{bare.height} pixels, {high - low:.0f} disparities)",
            lambda scale: matching_bytes(bare.width * scale, bare.height * scale, (high - low) * scale),
            fraction=0.6,
        )
        """Size of the rectified images relative to the reference's own resolution."""
        self.min_disparity = int(low * self.scale)
        self.num_disparities = int(np.ceil((high * self.scale - self.min_disparity + 1) / 16)) * 16
        searched = self.min_disparity / self.scale, (self.min_disparity + self.num_disparities) / self.scale
        self.rectification: Rectification = rectify(reference, other, searched, self.scale)

    def compute_depth(self, reference: Array, other: Array) -> DepthMap:
        """Return depth from two grey images (uint8) of the pair, checked strictly, to compare conditions."""
        return self._checked_depth(self._match_both_directions(reference, other))

    def compute_both(self, reference: Array, other: Array) -> tuple[DepthMap, FilledDepthMap]:
        """Return what `compute_depth` does, and depth that is filled from the background, by one match."""
        both_directions = self._match_both_directions(reference, other)
        return self._checked_depth(both_directions), self._filled_depth(both_directions)

    def _checked_depth(self, found: _Match) -> DepthMap:
        checked = found.checked()
        marked = self.rectification.to_reference(np.nan_to_num(found.difference, nan=-2.0) + 1.0)
        difference = np.where(marked > 0, marked - 1.0, np.nan).astype(np.float32)
        return DepthMap(self.rectification.depth(checked), difference)

    def _filled_depth(self, found: _Match) -> FilledDepthMap:
        """Return depth, depth with its holes filled from the background, and confidence.

        A filled pixel is part of the depth, too, if the forward match agrees with it, the other view sees
        nothing nearer there, or a nearer surface that both views see hides it from the other. All others are
        a guess. The stricter checks of `compute_depth` would reject more right pixels than wrong ones. What
        is too far for a finite depth has its least one.
        """
        filled = np.maximum(fill_holes(found.surface), ACCURACY_PX)
        finite = filled > ACCURACY_PX
        seen = warp_by_disparity(found.backward, filled)
        supported = np.abs(found.forward - filled) <= MAX_LEFT_RIGHT_PX
        supported |= seen <= filled + MAX_LEFT_RIGHT_PX
        occluder = warp_by_disparity(found.surface, filled - seen, nearest=True)
        hidden = (seen > filled + MAX_LEFT_RIGHT_PX) & (np.abs(occluder - seen) <= MAX_LEFT_RIGHT_PX)
        good = _without_islands((supported | hidden) & finite, filled)
        checked = np.where(good, filled, np.nan)
        return FilledDepthMap(
            depth=self.rectification.depth(checked),
            filled=self.rectification.depth(filled),
            confidence=self._confidence(found, np.isfinite(checked)),
        )

    def _match_both_directions(self, reference: Array, other: Array) -> _Match:
        a, seen_a = self.rectification.remap(reference)
        b, seen_b = self.rectification.remap(other, other=True)
        raw, backward = self._match(a, b, seen_a, seen_b)
        seen = warp_by_disparity(b, raw)
        there = np.isfinite(seen)
        gain, bias = gain_and_bias_of_shades(a[there], seen[there])
        bright = np.clip(gain * b + bias, 0, 255)
        if abs(gain - 1) > SAME_GAIN or abs(bias) > SAME_BIAS:
            raw, backward = self._match(a, np.round(bright).astype(np.uint8), seen_a, seen_b)
        b = bright.astype(np.float32)
        warped = warp_by_disparity(b, raw)
        left_right = np.abs(warp_by_disparity(backward, raw) - raw)
        shown = np.where(np.isfinite(warped), warped, a).astype(np.float32)
        similar = same_brightness(a.astype(np.float32), shown)
        agreed = np.where(_without_islands(similar & (left_right <= MAX_LEFT_RIGHT_PX), raw), raw, np.nan)
        return _Match(
            a,
            b,
            raw,
            backward,
            left_right,
            difference=np.abs(a.astype(np.float32) - warped),
            surface=refine_disparity(a, b, np.where(similar, fill_small_holes(agreed, raw), np.nan)),
            displacement=residual_displacement(a, shown.astype(np.uint8)),
        )

    def _match(self, a: Array, b: Array, seen_a: Array, seen_b: Array) -> tuple[Array, Array]:
        """Return the reference's disparity where both views reach, else NaN, and the other view's own."""
        height, width = a.shape
        with memory_budget().reserved(matching_bytes(width, height, self.num_disparities)):
            forward = match_rectified(a, b, self.min_disparity, self.num_disparities)
            backward = match_rectified_back(a, b, self.min_disparity, self.num_disparities)
        inside = warp_by_disparity(seen_b.astype(np.float32), forward) > 0.99
        return np.where(seen_a & inside, forward, np.nan), backward

    def _confidence(self, found: _Match, checked: Array) -> Array:
        left_right_fraction = np.nan_to_num(found.left_right, nan=np.inf) / MAX_LEFT_RIGHT_PX
        difference_fraction = cv2.blur(np.nan_to_num(found.difference, nan=255.0), (3, 3))
        difference_fraction /= MAX_GREY_DIFFERENCE + 3 * noise_level(found.reference)
        sure = 1 - 0.5 * np.minimum(left_right_fraction, 1) - 0.5 * np.minimum(difference_fraction, 1)
        confidence = np.where(checked, np.maximum(sure, 0.05), 0).astype(np.float32)
        return self.rectification.to_reference(confidence)


def _without_islands(accepted: Array, disparity: Array) -> Array:
    """Return the accepted pixels (bool) without small islands of a surface."""
    speckled = np.ascontiguousarray((np.where(accepted, disparity, -1.0) * 16).astype(np.int16))
    cv2.filterSpeckles(speckled, -16, MIN_ISLAND_PX, 2 * 16)
    return np.asarray(accepted & (speckled > -16))


def find_disparity_range(
    pair: tuple[View, View], images: list[tuple[Array, Array, Array]]
) -> tuple[float, float]:
    """Return the scene's min and max disparity, px, from a coarse match of synchronized images.

    `images` are pairs of grey images with the reference's motion mask (bool). All matchable pixels are
    matched at low resolution. Pixels without texture, or on which the two directions disagree, do not vote,
    and a few outliers are cut off. Moving objects vote separately: they are few, and often the nearest.

    Raises:
        ValueError: the two views have nothing in common, or cannot be rectified.
    """
    reference, other = pair
    scale = min(1.0, 320 / max(reference.width, reference.height))
    max_disparity = 0.5 * max(reference.width, reference.height)
    canvas = rectify(reference, other, (0.0, max_disparity), scale)
    count = int(np.ceil(max_disparity * scale / 16)) * 16
    votes, moving, asked = [np.zeros(0, np.float32)], [np.zeros(0, np.float32)], 0
    for image, partner, mask in images:
        a, seen_a = canvas.remap(image)
        b, seen_b = canvas.remap(partner, other=True)
        forward, backward = match_rectified(a, b, 0, count), match_rectified_back(a, b, 0, count)
        agrees = np.abs(warp_by_disparity(backward, forward) - forward) <= 1.0
        inside = warp_by_disparity(seen_b.astype(np.float32), forward) > 0.99
        grey = a.astype(np.float32)
        texture = np.abs(cv2.Sobel(cv2.GaussianBlur(grey, (0, 0), 1.0), cv2.CV_32F, 1, 0))
        warped = match_brightness(a, warp_by_disparity(b, forward))
        seen = np.where(np.isfinite(warped), warped, a)
        same = same_brightness(grey, seen) & (window_correlation(grey, seen) > MIN_CORRELATION)
        textured = seen_a & inside & (texture > 12)
        good = textured & agrees & same
        asked += int(textured.sum())
        votes.append(forward[good])
        moving.append(forward[good & (canvas.remap(mask.astype(np.uint8), nearest=True)[0] > 0)])
    offsets, fast = np.concatenate(votes), np.concatenate(moving)
    if len(offsets) < max(200, MIN_AGREEMENT * asked):
        raise ValueError("the two views have too little in common to match")
    low, high = np.percentile(offsets, [0.5, 99.5]) / scale
    if len(fast) >= 20:
        ends = np.percentile(fast, [3, 97]) / scale
        low, high = min(low, ends[0]), max(high, ends[1])
    margin = 0.15 * (high - low) + 4
    return max(0.0, float(low - margin)), float(high + margin)


def epipolar_errors(
    pair: StereoPair, reference: Array, other: Array, masks: Sequence[Array]
) -> list[list[float]]:
    """Return epipolar errors of patches on each mask, px at the reference's own resolution.

    Patches of the reference (grey, uint8) are searched in two dimensions; only confident matches count.
    """
    canvas = pair.rectification
    a, _ = canvas.remap(reference)
    b, seen = canvas.remap(other, other=True)
    min_contrast = 4 * noise_level(a) + 2
    shown = (canvas.remap(mask.astype(np.uint8), nearest=True)[0] for mask in masks)
    return [_patch_errors(pair, a, b, seen, on, min_contrast) for on in shown]


def _patch_errors(
    pair: StereoPair, a: Array, b: Array, seen: Array, on: Array, contrast: float
) -> list[float]:
    """Return the errors of patches on a canvas mask with at least this `contrast`."""
    half = PATCH_PX // 2
    ys, xs = np.nonzero(on[half : a.shape[0] - half, half : a.shape[1] - half])
    ys, xs = ys + half, xs + half
    if len(ys) < MIN_PIXELS:
        return []
    errors = []
    chosen = np.linspace(0, len(ys) - 1, 40).astype(int)
    for x, y in zip(xs[chosen].tolist(), ys[chosen].tolist(), strict=True):
        patch = a[y - half : y + half + 1, x - half : x + half + 1]
        left = max(0, x - pair.min_disparity - pair.num_disparities - half)
        right, top = x - pair.min_disparity + half + 1, max(0, y - half - ROWS_PX)
        strip = b[top : y + half + 1 + ROWS_PX, left : max(0, right)]
        if patch.std() < contrast or min(strip.shape) < PATCH_PX or not seen[y, left : max(0, right)].any():
            continue
        likeness = cv2.matchTemplate(strip, patch, cv2.TM_CCOEFF_NORMED)
        _, best, _, at = cv2.minMaxLoc(likeness)
        if best >= LIKENESS and 0 < at[1] < likeness.shape[0] - 1:
            row = at[1] + _peak(likeness[at[1] - 1 : at[1] + 2, at[0]]) + top + half
            errors.append(abs(row - y) / pair.scale)
    return errors


def _peak(values: Array) -> float:
    """Return the offset of a parabola's peak from the middle of three values, in -0.5..0.5."""
    low, middle, high = map(float, values)
    bend = low - 2 * middle + high
    return 0.0 if bend >= 0 else float(np.clip(0.5 * (low - high) / bend, -0.5, 0.5))
