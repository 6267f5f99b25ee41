"""Photographs of a panel as a camera in some hand takes them: askew, blurred, noisy, with glare.

Made without the arithmetic of `capture_app/panel`: each row of each lamp is watched at many moments of its
exposure, and each pixel is traced back through the lens onto the panel.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from capture_app.panel.pattern import Panel, Scan
from capture_app.simulation.rendering.panel_sight import see_panel

Floats = NDArray[np.float64]
Image = NDArray[np.uint8]

MOMENTS = 200
"""Moments of a row's exposure at which its lamps are watched."""
_LED_LIGHT, _SCREEN_LIGHT = (0.25, 0.5, 1.0), (1.0, 1.0, 1.0)
"""Blue, green and red of lamps: orange LEDs, white cells."""


@dataclass(frozen=True, slots=True)
class Photograph:
    """How a photograph is taken; lengths in pixels, times in ns, light as a share of a full sensor."""

    panel: Panel
    width: int
    height: int
    corners: tuple[tuple[float, float], ...]
    """Where the frame's corners are seen (x, y), but for the lens: clockwise from
    upper left."""
    exposure_ns: float
    row_time_ns: float
    distortion: float = 0.0
    """Radial, first term, by half of the picture's width."""
    defocus: float = 0.0
    """Standard deviation of the blur."""
    motion: tuple[float, float] = (0.0, 0.0)
    """The camera moved so far in the exposure."""
    lamp_light: float = 0.8
    """Of a lamp that is lit all the time."""
    ambient: float = 1.0
    uneven: float = 0.0
    """Lamps differ in brightness by this share (standard deviation), in all photographs alike."""
    vignette: float = 0.0
    """Loss of light in the corners."""
    glare: tuple[tuple[float, float, float, float], ...] = ()
    """Spots of light that shine back from the panel: x, y, reach and strength of each."""
    gamma: float = 2.2
    contrast: float = 0.0
    """How far the tone curve is bent to an S."""
    full_well: float = 6000.0
    """Electrons of a full pixel, whose square root is its noise; 0 = none."""
    read_noise: float = 4.0
    jpeg_quality: int | None = 92
    hidden: tuple[int, ...] = ()
    """Corners whose markers something covers."""
    scan_share: float = 0.95
    """Of a refresh: what a screen needs to draw from one edge of the panel to the other."""
    response_ns: float = 0.0
    """A screen's cells change so slowly (time constant)."""
    rate_error: float = 0.0
    """The panel's clock is fast by this share."""

    def take(self, start_ns: float, rng: np.random.Generator) -> Image:
        """The picture, BGR uint8 (height, width, 3), whose first row's exposure starts at that panel time."""
        scene = self._look(start_ns, rng)
        scene = self._blur(scene)
        y, x = np.mgrid[: self.height, : self.width]
        for at_x, at_y, reach, strength in self.glare:
            away = ((x - at_x) ** 2 + (y - at_y) ** 2) / reach**2
            scene += strength * np.exp(-0.5 * away)[..., None]
        away = (x - self.width / 2) ** 2 + (y - self.height / 2) ** 2
        scene *= 1 - self.vignette * (4 * away / (self.width**2 + self.height**2))[..., None]
        return self._develop(scene, rng)

    def _look(self, start_ns: float, rng: np.random.Generator) -> Floats:
        """Light (height, width, 3) that comes through a sharp lens."""
        sight = see_panel(
            self.panel, self.width, self.height, self.corners, self.distortion, tuple(sorted(self.hidden))
        )
        pairs, inverse = np.unique(np.stack([sight.lamp, sight.row]), axis=1, return_inverse=True)
        shares = self._shares(start_ns, pairs[0], pairs[1], rng)[inverse.ravel()]
        spread = np.random.default_rng(len(self.panel.name)).standard_normal(len(self.panel.lamps))
        gains = 1 + self.uneven * spread
        bright = self.lamp_light * gains[sight.lamp] * shares * sight.weight
        colour = np.array(_SCREEN_LIGHT if self.panel.is_screen else _LED_LIGHT)
        light = np.repeat(self.ambient * sight.still[..., None], 3, axis=2)
        np.add.at(light, (sight.row, sight.column), bright[:, None] * colour)
        return light

    def _shares(
        self, start_ns: float, lamps: NDArray[np.int64], rows: NDArray[np.int64], rng: np.random.Generator
    ) -> Floats:
        """Share of its exposure in which each of these lamps shines as seen from those rows, (n,)."""
        of = self.panel.lamps
        start, lit, period = (
            np.array([getattr(lamp, name) for lamp in of])[lamps, None] for name in ("start", "lit", "period")
        )
        late = np.array([self._late(lamp.x, lamp.y) for lamp in of])[lamps, None]
        within = (np.arange(MOMENTS) + rng.random((len(lamps), MOMENTS))) / MOMENTS * self.exposure_ns
        moments = start_ns + rows[:, None] * self.row_time_ns + within
        if self.response_ns:
            moments = moments - rng.exponential(self.response_ns, moments.shape)
        tick = np.floor(moments * (1 + self.rate_error) / self.panel.tick_ns - late).astype(np.int64)
        return np.asarray(((tick - start) % period < lit).mean(axis=1))

    def _late(self, x: float, y: float) -> float:
        """Refreshes by which a screen shows a place of the panel later than the middle of it."""
        across, down = x / self.panel.width, y / self.panel.height
        way = {Scan.DOWN: down, Scan.UP: 1 - down, Scan.RIGHT: across, Scan.LEFT: 1 - across}
        return self.scan_share * (way.get(self.panel.scan, 0.5) - 0.5)

    def _blur(self, scene: Floats) -> Floats:
        if self.defocus:
            scene = np.asarray(cv2.GaussianBlur(scene, (0, 0), self.defocus))
        length = float(np.hypot(*self.motion))
        if length > 0.5:
            reach = int(np.ceil(length / 2)) + 1
            kernel = np.zeros((2 * reach + 1, 2 * reach + 1))
            for share in np.linspace(-0.5, 0.5, 8 * reach):
                x, y = reach + share * self.motion[0], reach + share * self.motion[1]
                i, j = int(y), int(x)
                for di, dj in ((0, 0), (0, 1), (1, 0), (1, 1)):
                    kernel[i + di, j + dj] += (1 - abs(y - i - di)) * (1 - abs(x - j - dj))
            scene = np.asarray(cv2.filter2D(scene, -1, kernel / kernel.sum()))
        return scene

    def _develop(self, scene: Floats, rng: np.random.Generator) -> Image:
        """Noise, tone curve and JPEG."""
        scene = np.clip(scene, 0, None)
        if self.full_well:
            sigma = np.sqrt(scene / self.full_well + (self.read_noise / self.full_well) ** 2)
            grain = rng.standard_normal(scene.shape)
            # What a colour filter leaves out is filled in from its neighbours.
            scene = scene + sigma * 1.4 * np.asarray(cv2.GaussianBlur(grain, (0, 0), 0.6))
        tone = np.clip(scene, 0, 1) ** (1 / self.gamma)
        tone = (1 - self.contrast) * tone + self.contrast * tone * tone * (3 - 2 * tone)
        picture = np.rint(255 * tone).astype(np.uint8)
        if self.jpeg_quality is None:
            return picture
        _, coded = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, self.jpeg_quality])
        decoded = cv2.imdecode(coded, cv2.IMREAD_COLOR)
        assert decoded is not None, "it was encoded a line above"
        return np.asarray(decoded, np.uint8)
