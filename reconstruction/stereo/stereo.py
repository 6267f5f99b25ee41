"""Dense depth of a pair: semi-global matching, then checks that keep only what both views agree on."""

from dataclasses import dataclass, field

import cv2
import numpy as np

from reconstruction.common.geometry import Array, View
from reconstruction.stereo.rectify import Rectification, rectify

BLOCK = 5
"""Side of the matched window, px."""
CHECK_WINDOW = 9
"""Side of the window in which the two views must look alike, px."""

LEAST_AGREEMENT = 0.35
"""Share of textured pixels on whose coarse disparity both directions agree: views of the same thing reach
0.55 to 0.75, unrelated noise 0.27."""


@dataclass(frozen=True)
class Checks:
    """When a match is believed.

    `agreement_px`: left-right difference of disparity. `alike`: least normalized correlation of the two
    views in a window, asked for where there is texture. `grey`: greatest mean grey-level difference (of
    255) beside the noise. `residual_px`: greatest displacement that is left after the disparity is
    taken out; a true match leaves none, also not between rows.
    """

    agreement_px: float = 1.0
    alike: float = 0.0
    grey: float = 10.0
    residual_px: float = 0.7
    speckle_px: int = 60


@dataclass(frozen=True)
class DepthMap:
    """One pair's depth on the reference view's pixels.

    `depth` (height x width, calibration's unit, 0 = not believed), `raw` the same before the checks, and
    `difference`: grey levels between the reference and the other view warped onto it by the raw depth
    (NaN = none).
    """

    depth: Array
    raw: Array
    difference: Array
    confidence: Array = field(default_factory=lambda: np.zeros((0, 0), np.float32))
    """0 (not believed) to 1: half from how well both directions agree, half from how alike they look."""


def match(reference: Array, other: Array, low: int, count: int) -> Array:
    """Disparity (height x width, px, NaN = none) of a rectified pair; reference minus other, in
    [low, low + count), count a multiple of 16."""
    matcher = cv2.StereoSGBM.create(
        minDisparity=low,
        numDisparities=count,
        blockSize=BLOCK,
        P1=8 * BLOCK * BLOCK,
        P2=32 * BLOCK * BLOCK,
        disp12MaxDiff=-1,
        preFilterCap=31,
        uniquenessRatio=0,
        speckleWindowSize=0,
        speckleRange=0,
        mode=cv2.STEREO_SGBM_MODE_HH,
    )
    raw = matcher.compute(reference, other).astype(np.float32) / 16
    return np.asarray(np.where(raw < low, np.nan, raw), np.float32)


def match_back(reference: Array, other: Array, low: int, count: int) -> Array:
    """Disparity as in `match`, but on the other view's pixels."""
    # The matcher leaves out the first low + count columns: give it so many more of them.
    first, second = (
        np.ascontiguousarray(np.pad(image, ((0, 0), (0, low + count)))[:, ::-1])
        for image in (other, reference)
    )
    return match(first, second, low, count)[:, : low + count - 1 : -1]


def sample(image: Array, disparity: Array) -> Array:
    """The other view's image (float32) seen through the disparity, on the reference's canvas."""
    xs, ys = np.meshgrid(
        np.arange(disparity.shape[1], dtype=np.float32), np.arange(disparity.shape[0], dtype=np.float32)
    )
    shifted = (xs - np.nan_to_num(disparity, nan=1e6)).astype(np.float32)
    seen = cv2.remap(
        np.ascontiguousarray(image, np.float32),
        shifted,
        ys,
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=(float("nan"),),
    )
    return np.asarray(seen)


class StereoPair:
    """Depth from one calibrated pair, with everything that is not in the images fixed beforehand."""

    def __init__(
        self, reference: View, other: View, disparities: tuple[float, float], checks: Checks | None = None
    ) -> None:
        """The disparity range (px) comes from `scene_disparities`, the same for all conditions."""
        self.low = max(0, int(np.floor(disparities[0])))
        self.count = int(np.ceil((disparities[1] - self.low + 1) / 16)) * 16
        self.rectification: Rectification = rectify(reference, other, (self.low, self.low + self.count))
        self.checks = checks or Checks()

    def depth(self, reference: Array, other: Array) -> DepthMap:
        """Depth from two grey images (uint8) of the pair."""
        a, seen_a = self.rectification.remap(reference)
        b, seen_b = self.rectification.remap(other, other=True)
        forward = match(a, b, self.low, self.count)
        backward = match_back(a, b, self.low, self.count)
        inside = sample(seen_b.astype(np.float32), forward) > 0.99
        raw = np.where(seen_a & inside, forward, np.nan)
        warped = sample(b, raw)
        warped = level(a, warped)
        believed = self._believed(a, warped, raw, backward)
        checked = fill_small_holes(np.where(believed, raw, np.nan), raw)
        difference = np.abs(a.astype(np.float32) - warped)
        return DepthMap(
            depth=self.rectification.depth(np.nan_to_num(checked)),
            raw=self.rectification.depth(np.nan_to_num(raw)),
            difference=self._difference(difference),
            confidence=self._confidence(checked, difference, raw, backward, noise_level(a)),
        )

    def _confidence(
        self, checked: Array, difference: Array, raw: Array, backward: Array, noise: float
    ) -> Array:
        apart = np.nan_to_num(np.abs(sample(backward, raw) - raw), nan=np.inf) / self.checks.agreement_px
        unlike = cv2.blur(np.nan_to_num(difference, nan=255.0), (3, 3)) / (self.checks.grey + 3 * noise)
        sure = 1 - 0.5 * np.minimum(apart, 1) - 0.5 * np.minimum(unlike, 1)
        believed = np.where(np.isfinite(checked), np.maximum(sure, 0.05), 0).astype(np.float32)
        return self.rectification.to_reference(believed)

    def _difference(self, canvas: Array) -> Array:
        marked = self.rectification.to_reference(np.nan_to_num(canvas, nan=-2.0) + 1.0)
        return np.where(marked > 0, marked - 1.0, np.nan).astype(np.float32)

    def _believed(self, a: Array, warped: Array, disparity: Array, backward: Array) -> Array:
        checks = self.checks
        there = np.isfinite(disparity) & np.isfinite(warped)
        back = sample(backward, disparity)
        agrees = np.abs(back - disparity) <= checks.agreement_px
        view = np.where(there, warped, a).astype(np.float32)
        alike = looks_alike(a.astype(np.float32), view, checks)
        second = np.clip(view, 0, 255).astype(np.uint8)
        flow = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_FAST).calc(a, second, None)
        still = np.hypot(flow[..., 0], flow[..., 1]) <= checks.residual_px
        good = there & agrees & alike & still
        clean = np.where(good, disparity, -1.0) * 16
        speckled = np.ascontiguousarray(clean.astype(np.int16))
        cv2.filterSpeckles(speckled, -16, checks.speckle_px, 2 * 16)
        return np.asarray(good & (speckled > 0))


def looks_alike(a: Array, b: Array, checks: Checks) -> Array:
    """Where two images (float32, grey levels) show the same thing: correlation and brightness."""
    size = (CHECK_WINDOW, CHECK_WINDOW)
    mean_a, mean_b = cv2.blur(a, size), cv2.blur(b, size)
    var_a = np.maximum(cv2.blur(a * a, size) - mean_a**2, 0)
    var_b = np.maximum(cv2.blur(b * b, size) - mean_b**2, 0)
    both = cv2.blur(a * b, size) - mean_a * mean_b
    correlation = both / np.sqrt(np.maximum(var_a * var_b, 1e-3))
    noise = noise_level(a)
    flat = np.minimum(var_a, var_b) < (3 * noise) ** 2
    near = cv2.blur(np.abs(a - b), (3, 3)) < checks.grey + 3 * noise
    return np.asarray(near & (flat | (correlation > checks.alike)))


def noise_level(image: Array) -> float:
    """Standard deviation of an image's noise, grey levels (Immerkaer 1996, by the median)."""
    kernel = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)
    response = cv2.filter2D(np.ascontiguousarray(image, np.float32), -1, kernel)
    return float(np.median(np.abs(response))) * 1.4826 / 6.0


def level(a: Array, b: Array) -> Array:
    """b with gain and bias changed so that it is as bright as a (robust; NaN is left out)."""
    gain, bias = levelling(a, b)
    return np.asarray(gain * b + bias, np.float32)


def levelling(a: Array, b: Array) -> tuple[float, float]:
    """Gain and bias that make b as bright as a (robust; NaN is left out)."""
    ok = np.isfinite(b)
    if ok.sum() < 100:
        return 1.0, 0.0
    x, y = b[ok][::7].astype(np.float64), a[ok][::7].astype(np.float64)
    keep = np.ones(len(x), bool)
    gain, bias = 1.0, 0.0
    for _ in range(3):
        if keep.sum() < 50 or np.ptp(x[keep]) < 4:
            break
        gain, bias = np.polyfit(x[keep], y[keep], 1)
        error = np.abs(gain * x + bias - y)
        keep = error < 3 * max(float(np.median(error)), 0.5)
    return float(np.clip(gain, 0.5, 2.0)), float(bias)


def fill_small_holes(checked: Array, raw: Array) -> Array:
    """Unbelieved pixels beside believed ones (0.3 of a 7 x 7 window) are believed if they continue them."""
    good = np.isfinite(checked)
    value = np.where(good, checked, 0).astype(np.float32)
    weight = cv2.blur(good.astype(np.float32), (7, 7))
    mean = cv2.blur(value, (7, 7)) / np.maximum(weight, 1e-6)
    fits = ~good & (weight > 0.3) & (np.abs(raw - mean) < 1.0)
    return np.where(fits, raw, checked)


def scene_disparities(
    pair: tuple[View, View], images: list[tuple[Array, Array, Array]]
) -> tuple[float, float]:
    """Least and greatest disparity of the scene, px, from a coarse match of synchronized images.

    `images` are pairs of grey images and the reference's movers (bool). Matched at low resolution over
    everything that can be; pixels without texture, or on which the two directions disagree, do not
    vote, and a few wrong ones are left out. Movers vote apart: they are few, and often the nearest.

    Raises:
        ValueError: the two views have nothing in common.
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
        forward, backward = match(a, b, 0, count), match_back(a, b, 0, count)
        agrees = np.abs(sample(backward, forward) - forward) <= 1.0
        inside = sample(seen_b.astype(np.float32), forward) > 0.99
        smooth = cv2.GaussianBlur(a.astype(np.float32), (0, 0), 1.0)
        texture = np.abs(cv2.Sobel(smooth, cv2.CV_32F, 1, 0))
        warped = level(a, sample(b, forward))
        alike = looks_alike(a.astype(np.float32), np.where(np.isfinite(warped), warped, a), Checks(alike=0.7))
        textured = seen_a & inside & (texture > 12)
        good = textured & agrees & alike
        asked += int(textured.sum())
        votes.append(forward[good])
        moving.append(forward[good & (canvas.remap(movers.astype(np.uint8), nearest=True)[0] > 0)])
    found = np.concatenate(votes) if votes else np.zeros(0)
    if len(found) < max(200, LEAST_AGREEMENT * asked):
        raise ValueError("the two views have too little in common to match")
    low, high = np.percentile(found, [0.5, 99.5]) / scale
    fast = np.concatenate(moving)
    if len(fast) >= 20:
        ends = np.percentile(fast, [3, 97]) / scale
        low, high = min(low, ends[0]), max(high, ends[1])
    margin = 0.15 * (high - low) + 4
    return max(0.0, float(low - margin)), float(high + margin)
