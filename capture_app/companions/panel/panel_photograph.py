"""Photographs of a panel, and the paper's LED panel (section 6.1) as simulated cameras see it.

They share no arithmetic with the panel reader: each row of each lamp is sampled at many moments of its
exposure, and each pixel is traced back through the lens onto the panel.

Two panels stand side by side. The one with a tick of 200 us gives an image's time to microseconds within
20 ms; the one with 10 ms gives it to a millisecond within a second. The reader gets no information on the
panel or its position.
"""

from dataclasses import dataclass
from functools import lru_cache
from itertools import product

import cv2
import numpy as np
from numpy.typing import NDArray

from capture_app.companions.panel.cycle_code import Cycle, cell_places, encode_cycle
from capture_app.companions.panel.finder import Floats
from capture_app.companions.panel.pattern import (
    MARKER_MODULES,
    MARKER_SIZE,
    PANELS,
    Panel,
    marker_squares,
)

Image = NDArray[np.uint8]
Corners = tuple[tuple[float, float], ...]

SUBPIXELS = 2
"""Rays across a pixel, and down."""
_WALL, _WHITE, _BLACK, _GROUND, _COVER = 0.16, 0.55, 0.03, 0.035, 0.3
_LENS_RING = 0.05
"""Reflectance of surfaces, with 1 for a full sensor; unlit lamps have the last value."""
MOMENTS = 200
"""Number of moments of a row's exposure at which its lamps are sampled."""
_LED_LIGHT, _SCREEN_LIGHT = (0.25, 0.5, 1.0), (1.0, 1.0, 1.0)
"""Blue, green and red of lamps: orange LEDs, white cells."""
WIDTH, HEIGHT = 640, 480
PANEL = PANELS["led-pair"]
CYCLE_NS = round(PANEL.cycle_ns)
"""Period within which an image's time is unambiguous: 1 s."""
_CORNERS = ((27.0, 108.0), (611.0, 92.0), (620.0, 379.0), (19.0, 366.0))
"""Image positions of the frame's corners, seen from slightly to one side."""
UNEVEN = 0.05
"""Relative standard deviation of the LEDs' brightness."""


@lru_cache(maxsize=8)
def see_panel(
    panel: Panel,
    width: int,
    height: int,
    corners: Corners,
    distortion: float,
    hidden: tuple[int, ...],
    cycle: Cycle | None = None,
) -> tuple[Floats, NDArray[np.int64], Floats]:
    """Trace every pixel's rays back through the lens onto the panel.

    Returns three arrays: the light (height, width) of unlit surfaces; lamp, row and column (3, n) of each
    pixel that a lamp lights, with several entries for a pixel on an edge; and the lamp's brightness there
    (n,), with mean 1.
    """
    still = np.zeros((height, width))
    samples: list[tuple[NDArray[np.int64], Floats]] = []
    offsets = (np.arange(SUBPIXELS) + 0.5) / SUBPIXELS - 0.5
    weight = 1 / SUBPIXELS**2
    for dy, dx in product(offsets, offsets):
        x, y = _trace(panel, width, height, corners, distortion, float(dx), float(dy))
        which, profile = _lamp_at(panel, x, y)
        still += weight * np.where(which >= 0, _LENS_RING, _surface(panel, x, y, hidden, cycle))
        rows, columns = np.nonzero(which >= 0)
        samples.append((np.stack([which[rows, columns], rows, columns]), weight * profile[rows, columns]))
    places, weights = np.concatenate([f[0] for f in samples], axis=1), np.concatenate([f[1] for f in samples])
    keys, inverse = np.unique(places, axis=1, return_inverse=True)
    return still, keys, np.asarray(np.bincount(inverse.ravel(), weights, keys.shape[1]), np.float64)


def _trace(
    panel: Panel, width: int, height: int, corners: Corners, distortion: float, dx: float, dy: float
) -> tuple[Floats, Floats]:
    """Return the panel position (x, y) at which each pixel's ray ends."""
    y, x = np.mgrid[:height, :width].astype(float)
    half = width / 2
    across, down = (x + dx - half) / half, (y + dy - height / 2) / half
    bent = 1 + distortion * (across**2 + down**2)
    seen = np.stack([half + half * across * bent, height / 2 + half * down * bent], axis=-1)
    frame = np.array([[0, 0], [panel.width, 0], [panel.width, panel.height], [0, panel.height]], np.float32)
    matrix = cv2.getPerspectiveTransform(np.array(corners, np.float32), frame)
    ends = cv2.perspectiveTransform(seen.reshape(1, -1, 2), matrix).reshape(height, width, 2)
    return ends[..., 0], ends[..., 1]


def _surface(panel: Panel, x: Floats, y: Floats, hidden: tuple[int, ...], cycle: Cycle | None) -> Floats:
    """Return the light reflected by points of the panel and of the wall around it."""
    light = np.where(_is_on(panel, x, y), _WHITE, _WALL)
    for left, top, width, height in panel.dark:
        light[(x > left) & (x < left + width) & (y > top) & (y < top + height)] = _GROUND
    cells = zip(cell_places(panel), () if cycle is None else encode_cycle(cycle), strict=cycle is not None)
    for (left, top), _ in (cell for cell in cells if cell[1]):
        light[(x > left) & (x < left + 1) & (y > top) & (y < top + 1)] = _BLACK
    for corner, (number, left, top) in enumerate(panel.markers):
        squares = np.array(marker_squares(number))
        column = np.floor((x - left) / MARKER_SIZE * MARKER_MODULES).astype(int)
        row = np.floor((y - top) / MARKER_SIZE * MARKER_MODULES).astype(int)
        inside = (column >= 0) & (row >= 0) & (column < MARKER_MODULES) & (row < MARKER_MODULES)
        surface = np.where(squares[row[inside], column[inside]] > 0, _WHITE, _BLACK)
        light[inside] = _COVER if corner in hidden else surface
    return np.asarray(light)


def _is_on(panel: Panel, x: Floats, y: Floats) -> NDArray[np.bool_]:
    return np.asarray((x > 0) & (y > 0) & (x < panel.width) & (y < panel.height))


def _lamp_at(panel: Panel, x: Floats, y: Floats) -> tuple[NDArray[np.int64], Floats]:
    """Return the lamp that each ray hits, -1 for none, and its brightness there."""
    which, profile = np.full(x.shape, -1), np.zeros(x.shape)
    rows, columns = np.nonzero(_is_on(panel, x, y))
    x, y = x[rows, columns], y[rows, columns]
    # Lamps are placed on a lattice of half pitches, so that no two share a cell of it.
    lattice = np.full((round(2 * panel.width) + 3, round(2 * panel.height) + 3), -1)
    places = np.array([[lamp.x, lamp.y] for lamp in panel.lamps])
    lattice[tuple(np.rint(2 * places).astype(int).T)] = np.arange(len(places))
    best, shape = np.full(len(x), -1), np.zeros(len(x))
    size = panel.lamp_size / 2
    for di, dj in product((0, 1), (0, 1)):
        number = lattice[np.floor(2 * x).astype(int) + di, np.floor(2 * y).astype(int) + dj]
        across, down = (x - places[number, 0]) / size, (y - places[number, 1]) / size
        distance_squared = across**2 + down**2
        distances = np.maximum(np.abs(across), np.abs(down)) if panel.is_screen else distance_squared
        bright = np.ones(len(x)) if panel.is_screen else 1.3 - 0.6 * distance_squared
        inside = (distances < 1) & (number >= 0)
        best[inside], shape[inside] = number[inside], bright[inside]
    which[rows, columns], profile[rows, columns] = best, shape
    return which, profile


@dataclass(frozen=True)
class Photograph:
    """Settings of a photograph; lengths in pixels, times in ns, light as a fraction of a full sensor."""

    panel: Panel
    width: int
    height: int
    corners: tuple[tuple[float, float], ...]
    """Image positions (x, y) of the frame's corners without lens distortion: clockwise from upper left."""
    exposure_ns: float
    row_time_ns: float
    distortion: float = 0.0
    """First radial coefficient, for radii normalized by half the image's width."""
    defocus: float = 0.0
    """Standard deviation of the blur."""
    lamp_light: float = 0.8
    """Light of a lamp that is always lit."""
    ambient: float = 1.0
    uneven: float = 0.0
    """Relative standard deviation of the lamps' brightness, identical in all photographs."""
    vignette: float = 0.0
    """Loss of light in the corners."""
    gamma: float = 2.2
    full_well: float = 6000.0
    """Electrons of a full pixel, whose square root is its noise; 0 = no noise."""
    read_noise: float = 4.0
    hidden: tuple[int, ...] = ()
    """Corners whose markers are covered."""
    cycle: Cycle | None = None
    """Cycle that a screen's code shows; None: a page without a code."""

    def take(self, start_ns: float, rng: np.random.Generator) -> Image:
        """Return the image, BGR uint8 (height, width, 3), exposed from panel time `start_ns` in row 0."""
        scene = self._blur(self._look(start_ns, rng))
        y, x = np.mgrid[: self.height, : self.width]
        distance_squared = (x - self.width / 2) ** 2 + (y - self.height / 2) ** 2
        scene *= 1 - self.vignette * (4 * distance_squared / (self.width**2 + self.height**2))[..., None]
        return self._develop(scene, rng)

    def _look(self, start_ns: float, rng: np.random.Generator) -> Floats:
        """Return the light (height, width, 3) through a sharp lens."""
        still, (lamp, row, column), weight = see_panel(
            self.panel,
            self.width,
            self.height,
            self.corners,
            self.distortion,
            tuple(sorted(self.hidden)),
            self.cycle,
        )
        pairs, inverse = np.unique(np.stack([lamp, row]), axis=1, return_inverse=True)
        shares = self._shares(start_ns, pairs[0], pairs[1], rng)[inverse.ravel()]
        brightness = np.random.default_rng(len(self.panel.name)).standard_normal(len(self.panel.lamps))
        bright = self.lamp_light * (1 + self.uneven * brightness)[lamp] * shares * weight
        light = np.repeat(self.ambient * still[..., None], 3, axis=2)
        np.add.at(
            light, (row, column), np.outer(bright, _SCREEN_LIGHT if self.panel.is_screen else _LED_LIGHT)
        )
        return light

    def _shares(
        self, start_ns: float, lamps: NDArray[np.int64], rows: NDArray[np.int64], rng: np.random.Generator
    ) -> Floats:
        """Return the fraction (n,) of its exposure in which each lamp is lit, as seen from its row."""
        start, lit, period = (
            np.array([getattr(lamp, name) for lamp in self.panel.lamps])[lamps, None]
            for name in ("start", "lit", "period")
        )
        within = (np.arange(MOMENTS) + rng.random((len(lamps), MOMENTS))) / MOMENTS * self.exposure_ns
        moments = start_ns + rows[:, None] * self.row_time_ns + within
        tick = self._ticks(moments, lamps, rng).astype(np.int64)
        return np.asarray(((tick - start) % period < lit).mean(axis=1))

    def _ticks(self, moments: Floats, lamps: NDArray[np.int64], rng: np.random.Generator) -> Floats:
        """Return the panel's ticks that these lamps (n,) show at moments (n, ...) of its time."""
        return np.floor(moments / self.panel.tick_ns)

    def _blur(self, scene: Floats) -> Floats:
        return np.asarray(cv2.GaussianBlur(scene, (0, 0), self.defocus)) if self.defocus else scene

    def _tone(self, scene: Floats) -> Floats:
        """Return the levels, 0 to 1, of linear light."""
        return np.asarray(np.clip(scene, 0, 1) ** (1 / self.gamma))

    def _develop(self, scene: Floats, rng: np.random.Generator) -> Image:
        """Apply noise and tone curve."""
        scene = np.clip(scene, 0, None)
        if self.full_well:
            sigma = np.sqrt(scene / self.full_well + (self.read_noise / self.full_well) ** 2)
            # Demosaicing fills in values from neighbouring pixels, which correlates their noise.
            grain = cv2.GaussianBlur(rng.standard_normal(scene.shape), (0, 0), 0.6)
            scene = scene + sigma * 1.4 * np.asarray(grain)
        return np.rint(255 * self._tone(scene)).astype(np.uint8)


def render(
    start_ns: int, *, exposure_ns: int, row_time_ns: float, rng: np.random.Generator, true_ppm: float = 0.0
) -> Image:
    """Return the image (HEIGHT x WIDTH x 3, BGR) whose first row's exposure starts at `start_ns`.

    Each row's exposure starts `row_time_ns` after the row above it and lasts `exposure_ns`; `true_ppm` is the
    error of the camera's crystal. The panel's time is 0 at 0 ns.
    """
    stretch = 1.0 + true_ppm * 1e-6
    return Photograph(
        PANEL,
        WIDTH,
        HEIGHT,
        _CORNERS,
        exposure_ns * stretch,
        row_time_ns * stretch,
        distortion=-0.02,
        defocus=0.6,
        uneven=UNEVEN,
        vignette=0.1,
        ambient=0.8,
    ).take(start_ns % CYCLE_NS, rng)
