"""The range of disparities in a scene, from a coarse match."""

import cv2
import numpy as np

from reconstruction.common.brightness import match_brightness
from reconstruction.common.geometry import Array, View
from reconstruction.stereo.match_checks import MatchChecks, same_appearance
from reconstruction.stereo.rectification import rectify
from reconstruction.stereo.sgbm import match_rectified, match_rectified_back, warp_by_disparity

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
        forward, backward = match_rectified(a, b, 0, count), match_rectified_back(a, b, 0, count)
        agrees = np.abs(warp_by_disparity(backward, forward) - forward) <= 1.0
        inside = warp_by_disparity(seen_b.astype(np.float32), forward) > 0.99
        smooth = cv2.GaussianBlur(a.astype(np.float32), (0, 0), 1.0)
        texture = np.abs(cv2.Sobel(smooth, cv2.CV_32F, 1, 0))
        warped = match_brightness(a, warp_by_disparity(b, forward))
        same = same_appearance(
            a.astype(np.float32), np.where(np.isfinite(warped), warped, a), MatchChecks(min_correlation=0.7)
        )
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
