"""Dense depth of a pair, the range of its disparities, and how far matches lie from their epipolar line.

Depth is by semi-global matching, then checks keep only what both views agree on.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from reconstruction.common.brightness import gain_and_bias_of_shades, match_brightness, noise_level
from reconstruction.common.geometry import Array, View
from reconstruction.common.memory_budget import memory_budget
from reconstruction.stereo.hole_filling import fill_holes
from reconstruction.stereo.rectification import Rectification, rectify
from reconstruction.stereo.sgbm import (
    MatchChecks,
    fill_small_holes,
    match_rectified,
    match_rectified_back,
    matching_bytes,
    same_appearance,
    warp_by_disparity,
)
from reconstruction.stereo.subpixel import refine_disparity

SAME_GAIN, SAME_BIAS = 0.05, 4.0
"""Pictures that differ by more (factor, grey levels) are made equally bright and matched again."""
VOLUME_SHARE = 0.6
"""Of the memory budget, for matching; the rest is for pictures and maps."""


@dataclass(frozen=True)
class DepthMap:
    """One pair's depth on the reference view's pixels.

    `depth` (height x width, calibration's unit, 0 = none or rejected), and `difference`: grey levels between
    the reference and the other view warped onto it by the depth before the checks (NaN = none).
    """

    depth: Array
    difference: Array


@dataclass(frozen=True)
class FilledDepthMap(DepthMap):
    """The same, with a depth for every pixel: `filled`, the rest taken from the background beside it."""

    filled: Array
    confidence: Array
    """0 (rejected) to 1: half from how well both directions agree, half from how similar they look."""


class _Match(NamedTuple):
    """On the canvas: the reference, checked disparity, and how far grey levels and both directions differ."""

    reference: Array
    checked: Array
    difference: Array
    left_right: Array


class StereoPair:
    """Depth from one calibrated pair, with everything that is not in the images fixed beforehand."""

    def __init__(self, reference: View, other: View, disparities: tuple[float, float]) -> None:
        """The disparity range (px) comes from `find_disparity_range`, the same for all conditions.

        A range and a canvas that take more than the memory budget are matched at a smaller scale.

        Raises:
            ValueError: the two cannot be rectified.
        """
        low, high = max(0, int(np.floor(disparities[0]))), disparities[1]
        bare = rectify(reference, other, (low, high))
        self.scale = memory_budget().fit_scale(
            f"depth of a pair ({bare.width}x{bare.height} pixels, {high - low:.0f} disparities)",
            lambda scale: matching_bytes(bare.width * scale, bare.height * scale, (high - low) * scale),
            share=VOLUME_SHARE,
        )
        """Of the rectified pictures, against the reference's own resolution."""
        self.min_disparity = int(low * self.scale)
        self.num_disparities = int(np.ceil((high * self.scale - self.min_disparity + 1) / 16)) * 16
        end = self.min_disparity + self.num_disparities
        reach = self.min_disparity / self.scale, end / self.scale
        self.rectification: Rectification = rectify(reference, other, reach, self.scale)
        self.checks = MatchChecks()

    def compute_depth(self, reference: Array, other: Array) -> DepthMap:
        """Depth from two grey images (uint8) of the pair, checked from left to right and back."""
        found = self._match_checked(reference, other)
        return DepthMap(self._depth(found.checked), self._difference(found.difference))

    def compute_filled_depth(self, reference: Array, other: Array) -> FilledDepthMap:
        """The same, and a guess wherever it was rejected."""
        found = self._match_checked(reference, other)
        return FilledDepthMap(
            depth=self._depth(found.checked),
            difference=self._difference(found.difference),
            filled=self._depth(fill_holes(found.checked)),
            confidence=self._confidence(found),
        )

    def _depth(self, disparity: Array) -> Array:
        return self.rectification.depth(np.nan_to_num(disparity))

    def _match_checked(self, reference: Array, other: Array) -> _Match:
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
        consistent = self._consistent_pixels(a, warped, raw, left_right)
        checked = refine_disparity(a, b, fill_small_holes(np.where(consistent, raw, np.nan), raw))
        return _Match(a, checked, np.abs(a.astype(np.float32) - warped), left_right)

    def _match(self, a: Array, b: Array, seen_a: Array, seen_b: Array) -> tuple[Array, Array]:
        """The reference's disparity where both views reach, NaN elsewhere, and the other view's own."""
        forward = match_rectified(a, b, self.min_disparity, self.num_disparities)
        backward = match_rectified_back(a, b, self.min_disparity, self.num_disparities)
        inside = warp_by_disparity(seen_b.astype(np.float32), forward) > 0.99
        return np.where(seen_a & inside, forward, np.nan), backward

    def _confidence(self, found: _Match) -> Array:
        left_right_share = np.nan_to_num(found.left_right, nan=np.inf) / self.checks.max_left_right_px
        greatest = self.checks.max_grey_difference + 3 * noise_level(found.reference)
        difference_share = cv2.blur(np.nan_to_num(found.difference, nan=255.0), (3, 3)) / greatest
        sure = 1 - 0.5 * np.minimum(left_right_share, 1) - 0.5 * np.minimum(difference_share, 1)
        confidence = np.where(np.isfinite(found.checked), np.maximum(sure, 0.05), 0).astype(np.float32)
        return self.rectification.to_reference(confidence)

    def _difference(self, canvas: Array) -> Array:
        marked = self.rectification.to_reference(np.nan_to_num(canvas, nan=-2.0) + 1.0)
        return np.where(marked > 0, marked - 1.0, np.nan).astype(np.float32)

    def _consistent_pixels(self, a: Array, warped: Array, disparity: Array, left_right: Array) -> Array:
        checks = self.checks
        there = np.isfinite(disparity) & np.isfinite(warped)
        agrees = left_right <= checks.max_left_right_px
        view = np.where(there, warped, a).astype(np.float32)
        same = same_appearance(a.astype(np.float32), view, checks)
        second = np.clip(view, 0, 255).astype(np.uint8)
        flow = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_FAST).calc(a, second, None)
        still = np.hypot(flow[..., 0], flow[..., 1]) <= checks.max_residual_px
        good = there & agrees & same & still
        speckled = np.ascontiguousarray((np.where(good, disparity, -1.0) * 16).astype(np.int16))
        cv2.filterSpeckles(speckled, -16, checks.min_island_px, 2 * 16)
        return np.asarray(good & (speckled > 0))


MIN_AGREEMENT = 0.35
"""Share of textured pixels on whose coarse disparity both directions agree: views of the same thing reach
0.55 to 0.75, unrelated noise 0.27."""


def find_disparity_range(
    pair: tuple[View, View], images: list[tuple[Array, Array, Array]]
) -> tuple[float, float]:
    """Least and greatest disparity of the scene, px, from a coarse match of synchronized images.

    `images` are pairs of grey images and the reference's movers (bool). Matched at low resolution over
    everything that can be; pixels without texture, or on which the two directions disagree, do not
    vote, and a few wrong ones are left out. Movers vote separately: they are few, and often the nearest.

    Raises:
        ValueError: the two views have nothing in common, or cannot be rectified.
    """
    reference, other = pair
    scale = min(1.0, 320 / max(reference.width, reference.height))
    reach = 0.5 * max(reference.width, reference.height)
    canvas = rectify(reference, other, (0.0, reach), scale)
    count = int(np.ceil(reach * scale / 16)) * 16
    votes, moving, asked = [], [], 0
    for image, partner, movers in images:
        a, seen_a = canvas.remap(image)
        b, seen_b = canvas.remap(partner, other=True)
        forward, backward = match_rectified(a, b, 0, count), match_rectified_back(a, b, 0, count)
        agrees = np.abs(warp_by_disparity(backward, forward) - forward) <= 1.0
        inside = warp_by_disparity(seen_b.astype(np.float32), forward) > 0.99
        smooth = cv2.GaussianBlur(a.astype(np.float32), (0, 0), 1.0)
        texture = np.abs(cv2.Sobel(smooth, cv2.CV_32F, 1, 0))
        warped = match_brightness(a, warp_by_disparity(b, forward))
        seen = np.where(np.isfinite(warped), warped, a)
        same = same_appearance(a.astype(np.float32), seen, MatchChecks(min_correlation=0.7))
        textured = seen_a & inside & (texture > 12)
        good = textured & agrees & same
        asked += int(textured.sum())
        votes.append(forward[good])
        moving.append(forward[good & (canvas.remap(movers.astype(np.uint8), nearest=True)[0] > 0)])
    found = np.concatenate(votes) if votes else np.zeros(0)
    if len(found) < max(200, MIN_AGREEMENT * asked):
        raise ValueError("the two views have too little in common to match")
    low, high = np.percentile(found, [0.5, 99.5]) / scale
    fast = np.concatenate(moving)
    if len(fast) >= 20:
        ends = np.percentile(fast, [3, 97]) / scale
        low, high = min(low, ends[0]), max(high, ends[1])
    margin = 0.15 * (high - low) + 4
    return max(0.0, float(low - margin)), float(high + margin)


MIN_PIXELS = 30
"""Fewer pixels than this are not measured."""
PATCH_PX = 21
PATCHES = 40
ROWS_PX = 28
"""How far from its row a patch is searched, px."""
LIKENESS = 0.75


def epipolar_errors(
    pair: StereoPair, reference: Array, other: Array, masks: Sequence[Array]
) -> list[list[float]]:
    """How far matched patches on each of the masks lie from their row, px at the reference's own resolution.

    Patches of the reference (grey, uint8) are looked for freely in two dimensions; only sure finds count.
    """
    canvas = pair.rectification
    a, _ = canvas.remap(reference)
    b, seen = canvas.remap(other, other=True)
    least = 4 * noise_level(a) + 2
    shown = [canvas.remap(mask.astype(np.uint8), nearest=True)[0] for mask in masks]
    return [_patch_errors(pair, a, b, seen, on, least) for on in shown]


def _patch_errors(pair: StereoPair, a: Array, b: Array, seen: Array, on: Array, least: float) -> list[float]:
    """The errors of patches on a mask of the canvas whose contrast is at least so large."""
    half = PATCH_PX // 2
    ys, xs = np.nonzero(on)
    inside = (xs >= half) & (xs < a.shape[1] - half) & (ys >= half) & (ys < a.shape[0] - half)
    ys, xs = ys[inside], xs[inside]
    if len(ys) < MIN_PIXELS:
        return []
    errors = []
    for i in np.linspace(0, len(ys) - 1, PATCHES).astype(int):
        x, y = int(xs[i]), int(ys[i])
        patch = a[y - half : y + half + 1, x - half : x + half + 1]
        if patch.std() < least:
            continue
        left = max(0, x - pair.min_disparity - pair.num_disparities - half)
        right = min(b.shape[1], x - pair.min_disparity + half + 1)
        top, bottom = max(0, y - half - ROWS_PX), min(b.shape[0], y + half + 1 + ROWS_PX)
        strip = b[top:bottom, left:right]
        if min(strip.shape) < PATCH_PX or not seen[y, left:right].any():
            continue
        likeness = cv2.matchTemplate(strip, patch, cv2.TM_CCOEFF_NORMED)
        _, best, _, at = cv2.minMaxLoc(likeness)
        if best >= LIKENESS and 0 < at[1] < likeness.shape[0] - 1:
            found = at[1] + _peak(likeness[at[1] - 1 : at[1] + 2, at[0]]) + top + half
            errors.append(abs(found - y) / pair.scale)
    return errors


def _peak(values: Array) -> float:
    """Offset of a parabola's top from the middle of three values, in -0.5..0.5."""
    low, middle, high = (float(value) for value in values)
    bend = low - 2 * middle + high
    return 0.0 if bend >= 0 else float(np.clip(0.5 * (low - high) / bend, -0.5, 0.5))
