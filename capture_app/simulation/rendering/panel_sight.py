"""What a camera sees of a panel through a sharp lens: which pixels show what, whatever is lit."""

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from capture_app.panel.pattern import MARKER_MODULES, MARKER_SIZE, Panel, marker_squares

Floats = NDArray[np.float64]
Corners = tuple[tuple[float, float], ...]

SUBPIXELS = 2
"""Rays across a pixel, and down."""
_WALL, _WHITE, _BLACK, _GROUND, _COVER = 0.16, 0.55, 0.03, 0.035, 0.3
_LENS_RING = 0.05
"""Light that surfaces throw back, of 1 where the sensor is full; lamps that are off throw back the last."""


@dataclass(frozen=True, slots=True)
class PanelSight:
    """Of a picture: the light (height, width) of what does not shine, and the pixels on which lamps do."""

    still: Floats
    lamp: NDArray[np.int64]
    """Number of the lamp, (n,), of a pixel that it shines on; a pixel on an edge has more than one."""
    row: NDArray[np.int64]
    column: NDArray[np.int64]
    weight: Floats
    """How bright that lamp makes the pixel, 1 for its mean."""


@lru_cache(maxsize=8)
def see_panel(
    panel: Panel, width: int, height: int, corners: Corners, distortion: float, hidden: tuple[int, ...]
) -> PanelSight:
    """Trace every pixel's rays back through the lens onto the panel."""
    still = np.zeros((height, width))
    found: list[tuple[NDArray[np.int64], Floats]] = []
    offsets = (np.arange(SUBPIXELS) + 0.5) / SUBPIXELS - 0.5
    share = 1 / SUBPIXELS**2
    for dy in offsets:
        for dx in offsets:
            x, y = _trace(panel, width, height, corners, distortion, float(dx), float(dy))
            which, profile = _lamp_at(panel, x, y)
            still += share * np.where(which >= 0, _LENS_RING, _surface(panel, x, y, hidden))
            rows, columns = np.nonzero(which >= 0)
            found.append((np.stack([which[rows, columns], rows, columns]), share * profile[rows, columns]))
    places, weights = np.concatenate([f[0] for f in found], axis=1), np.concatenate([f[1] for f in found])
    keys, inverse = np.unique(places, axis=1, return_inverse=True)
    lamp, row, column = keys
    summed = np.asarray(np.bincount(inverse.ravel(), weights, len(lamp)), np.float64)
    return PanelSight(still, lamp, row, column, summed)


def _trace(
    panel: Panel, width: int, height: int, corners: Corners, distortion: float, dx: float, dy: float
) -> tuple[Floats, Floats]:
    """Where on the panel (x, y) each pixel's ray ends."""
    y, x = np.mgrid[:height, :width].astype(float)
    half = width / 2
    across, down = (x + dx - half) / half, (y + dy - height / 2) / half
    bent = 1 + distortion * (across**2 + down**2)
    seen = np.stack([half + half * across * bent, height / 2 + half * down * bent], axis=-1)
    frame = np.array([[0, 0], [panel.width, 0], [panel.width, panel.height], [0, panel.height]], np.float32)
    matrix = cv2.getPerspectiveTransform(np.array(corners, np.float32), frame)
    ends = cv2.perspectiveTransform(seen.reshape(1, -1, 2), matrix).reshape(height, width, 2)
    return ends[..., 0], ends[..., 1]


def _surface(panel: Panel, x: Floats, y: Floats, hidden: tuple[int, ...]) -> Floats:
    """Light that places of the panel and of the wall around it throw back."""
    on = (x > 0) & (y > 0) & (x < panel.width) & (y < panel.height)
    light = np.where(on, _WHITE, _WALL)
    for left, top, width, height in panel.dark:
        light[(x > left) & (x < left + width) & (y > top) & (y < top + height)] = _GROUND
    for number, marker in enumerate(panel.markers):
        squares = np.array(marker_squares(marker.number))
        column = np.floor((x - marker.x) / MARKER_SIZE * MARKER_MODULES).astype(int)
        row = np.floor((y - marker.y) / MARKER_SIZE * MARKER_MODULES).astype(int)
        inside = (column >= 0) & (row >= 0) & (column < MARKER_MODULES) & (row < MARKER_MODULES)
        white = squares[row[inside], column[inside]] > 0
        light[inside] = _COVER if number in hidden else np.where(white, _WHITE, _BLACK)
    return np.asarray(light)


def _lamp_at(panel: Panel, x: Floats, y: Floats) -> tuple[NDArray[np.int64], Floats]:
    """The lamp that each ray hits, -1 for none, and how bright it is there."""
    which, profile = np.full(x.shape, -1), np.zeros(x.shape)
    ground = (x > 0) & (y > 0) & (x < panel.width) & (y < panel.height)
    rows, columns = np.nonzero(ground)
    x, y = x[rows, columns], y[rows, columns]
    # Lamps stand on a lattice of half pitches, so that no two share a cell of it.
    numbers = {(round(2 * lamp.x), round(2 * lamp.y)): n for n, lamp in enumerate(panel.lamps)}
    lattice = np.full((round(2 * panel.width) + 3, round(2 * panel.height) + 3), -1)
    places = np.array([[lamp.x, lamp.y] for lamp in panel.lamps])
    for (i, j), number in numbers.items():
        lattice[i, j] = number
    best, shape = np.full(len(x), -1), np.zeros(len(x))
    size = panel.lamp_size / 2
    for di in (0, 1):
        for dj in (0, 1):
            number = lattice[np.floor(2 * x).astype(int) + di, np.floor(2 * y).astype(int) + dj]
            across, down = (x - places[number, 0]) / size, (y - places[number, 1]) / size
            away = across**2 + down**2
            if panel.is_screen:
                inside, bright = np.maximum(np.abs(across), np.abs(down)) < 1, np.ones(len(x))
            else:
                inside, bright = away < 1, 1.3 - 0.6 * away
            inside &= number >= 0
            best[inside], shape[inside] = number[inside], bright[inside]
    which[rows, columns], profile[rows, columns] = best, shape
    return which, profile
