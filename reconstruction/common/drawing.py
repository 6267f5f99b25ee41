"""Pictures for people to look at: without text, and with both conditions at the same crop and scale."""

import cv2
import numpy as np

from reconstruction.common.geometry import Array

EMPTY = (34, 30, 28)
"""BGR of pixels without data."""
FOUND = (172, 182, 38)
"""Teal: a moving pixel with depth."""
LOST = (40, 130, 250)
"""Orange: a moving pixel without depth, or with wrong depth."""
LINE = (255, 255, 255)
GAP_PX = 6


def display_range(depth: Array, moving: Array | None = None) -> tuple[float, float]:
    """Return the nearest and farthest depth to show, without the outer 1 % but including moving objects."""
    if not len(known := depth[depth > 0]):
        return 1.0, 2.0
    ends = [np.percentile(known, [1, 99])]
    if moving is not None and len(fast := depth[moving & (depth > 0)]):
        ends.append(np.percentile(fast, [10, 90]))
    near, far = float(np.min(ends)), float(np.max(ends))
    return near, max(far, near * 1.05)


def colour_depth(depth: Array, near: float, far: float) -> Array:
    """Colour a depth map (BGR): near is bright yellow, far deep blue, linear in 1/depth; unknown is dark."""
    if not depth.size:
        # OpenCV divides by the number of pixels, which ends the process.
        return np.zeros((*depth.shape, 3), np.uint8)
    level = (1 / np.where(depth > 0, depth, far) - 1 / far) / (1 / near - 1 / far)
    # The lowest part of the colour map is as dark as empty pixels.
    picture = cv2.applyColorMap(np.uint8(255 * (0.14 + 0.86 * np.clip(level, 0, 1))), cv2.COLORMAP_VIRIDIS)
    picture[depth <= 0] = EMPTY
    return np.asarray(picture)


def colour_confidence(confidence: Array) -> Array:
    """Colour a map of confidence (BGR): orange up to 50 %, teal at 100 %, and dark where there is none."""
    level = np.clip(2 * confidence.astype(np.float32) - 1, 0, 1)[..., None]
    teal, orange = (np.array(colour, np.float32) for colour in (FOUND, LOST))
    picture = np.rint(level * teal + (1 - level) * orange).astype(np.uint8)
    picture[confidence <= 0] = EMPTY
    return np.asarray(picture)


def mark_moving(image: Array, moving: Array, known: Array) -> Array:
    """Return the photograph, paler, with moving pixels in teal if depth was found and in orange if not."""
    grey = cv2.cvtColor(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2BGR)
    picture = (0.6 * grey + 0.2 * image).astype(np.float32)
    for mask, colour in ((moving & known, FOUND), (moving & ~known, LOST)):
        picture[mask] = 0.25 * grey[mask] + 0.75 * np.array(colour, np.float32)
    return np.asarray(np.clip(picture, 0, 255), np.uint8)


def side_by_side(left: Array, right: Array) -> Array:
    """Return two pictures of equal height next to each other, with a gap."""
    return np.hstack([left, np.full((len(left), GAP_PX, 3), EMPTY, np.uint8), right])


def draw_rows(left: Array, right: Array, rows: list[int]) -> Array:
    """Draw thin lines across a rectified pair; corresponding points must be on the same line."""
    picture = side_by_side(left, right)
    lines = picture.copy()
    thickness = max(1, picture.shape[0] // 400)
    for row in rows:
        cv2.line(lines, (0, row), (picture.shape[1], row), LINE, thickness, cv2.LINE_AA)
    return np.asarray(cv2.addWeighted(lines, 0.65, picture, 0.35, 0))


def box_around(
    mask: Array, *, spare: float = 0.4, aspect: float = 4 / 3, min_px: int = 64, max_fraction: float = 1.0
) -> tuple[int, ...]:
    """Return left, top, right, bottom (px) of a box with margins around the largest region of a mask.

    The box has a fixed aspect ratio. `spare` is the margin as a fraction of the region's size, `max_fraction`
    the maximum fraction of the picture's width.
    """
    height, width = mask.shape
    count, _, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8))
    if count < 2:
        return 0, 0, width, height
    x, y, w, h, _ = (int(v) for v in stats[1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))])
    wide = max(w * (1 + 2 * spare), aspect * h * (1 + 2 * spare), min_px)
    wide = min(wide, width * max_fraction, height * aspect)
    tall = wide / aspect
    left = int(np.clip(x + w / 2 - wide / 2, 0, width - wide))
    top = int(np.clip(y + h / 2 - tall / 2, 0, height - tall))
    return left, top, left + int(wide), top + int(tall)


def enlarge_crop(picture: Array, box: tuple[int, ...], *, smooth: bool = True) -> Array:
    """Return a crop of a picture, enlarged for display."""
    left, top, right, bottom = box
    part = picture[top:bottom, left:right]
    scale = max(1.0, 480 / max(part.shape[1], 1))
    how = cv2.INTER_CUBIC if smooth else cv2.INTER_NEAREST
    return np.asarray(cv2.resize(part, None, fx=scale, fy=scale, interpolation=how))


def box_of_max_weight(weight: Array, fraction: float, aspect: float = 4 / 3) -> tuple[int, ...]:
    """Return left, top, right, bottom of the box with the most weight; `fraction`: its part of the width."""
    height, width = weight.shape
    wide = int(min(width * fraction, height * aspect))
    tall = int(wide / aspect)
    sums = cv2.integral(weight.astype(np.float64))
    held = sums[tall:, wide:] - sums[:-tall, wide:] - sums[tall:, :-wide] + sums[:-tall, :-wide]
    # Of all boxes with equal weight, the middle one.
    rows, columns = np.nonzero(held >= held.max() - 1e-6 * max(float(held.max()), 1.0))
    top, left = int(np.median(rows)), int(np.median(columns))
    return left, top, left + wide, top + tall


def trim_empty_borders(seen: Array) -> tuple[slice, slice]:
    """Return the part of a panorama without empty borders, cutting the worst side until none is empty."""
    top, bottom, left, right = 0, seen.shape[0], 0, seen.shape[1]
    while bottom - top > 32 and right - left > 32:
        part = seen[top:bottom, left:right]
        empty = [1 - float(side.mean()) for side in (part[0], part[-1], part[:, 0], part[:, -1])]
        worst = int(np.argmax(empty))
        if empty[worst] == 0:
            break
        top, bottom = top + (worst == 0), bottom - (worst == 1)
        left, right = left + (worst == 2), right - (worst == 3)
    return slice(top, bottom), slice(left, right)
