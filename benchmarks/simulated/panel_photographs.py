"""Handheld photographs of panels, and the time read from the paper's panel."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from capture_app.companions.panel.finder import Floats
from capture_app.companions.panel.panel_photograph import CYCLE_NS, Image, Photograph
from capture_app.companions.panel.pattern import nearest_ns
from capture_app.companions.panel.time_reading import read_panel


@dataclass(frozen=True)
class HandheldPhotograph(Photograph):
    """A photograph with the effects of a hand, the room, a screen and a phone's processing."""

    motion: tuple[float, float] = (0.0, 0.0)
    """Motion of the camera during the exposure."""
    glare: tuple[tuple[float, float, float, float], ...] = ()
    """Reflections on the panel: x, y, radius and strength of each."""
    contrast: float = 0.0
    """Strength of the tone curve's S shape."""
    jpeg_quality: int | None = 92
    scan_share: float = 0.95
    """Fraction of a refresh that a screen needs to draw from one edge of the panel to the other."""
    response_ns: float = 0.0
    """Time constant of a screen's cells."""
    rate_error: float = 0.0
    """Relative rate error of the panel's clock; positive if it is fast."""

    def take(self, start_ns: float, rng: np.random.Generator) -> Image:
        """Return the image, BGR uint8 (height, width, 3); its first row's exposure starts at `start_ns`."""
        picture = super().take(start_ns, rng)
        if self.jpeg_quality is None:
            return picture
        _, coded = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, self.jpeg_quality])
        decoded = cv2.imdecode(coded, cv2.IMREAD_COLOR)
        assert decoded is not None, "it was encoded a line above"
        return np.asarray(decoded, np.uint8)

    def _ticks(self, moments: Floats, lamps: NDArray[np.int64], rng: np.random.Generator) -> Floats:
        if self.response_ns:
            moments = moments - rng.exponential(self.response_ns, moments.shape)
        late = np.array([self._late(lamp.x, lamp.y) for lamp in self.panel.lamps])[lamps, None]
        return np.asarray(np.floor(moments * (1 + self.rate_error) / self.panel.tick_ns - late))

    def _late(self, x: float, y: float) -> float:
        """Return a screen's delay at a place of the panel against the panel's middle, in refreshes."""
        across, down = x / self.panel.width, y / self.panel.height
        way = {"down": down, "up": 1 - down, "right": across, "left": 1 - across}
        return self.scan_share * (way.get(self.panel.scan, 0.5) - 0.5)

    def _blur(self, scene: Floats) -> Floats:
        scene = super()._blur(scene)
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
        y, x = np.mgrid[: self.height, : self.width]
        for at_x, at_y, radius, strength in self.glare:
            away = ((x - at_x) ** 2 + (y - at_y) ** 2) / radius**2
            scene += strength * np.exp(-0.5 * away)[..., None]
        return scene

    def _tone(self, scene: Floats) -> Floats:
        tone = super()._tone(scene)
        return (1 - self.contrast) * tone + self.contrast * tone * tone * (3 - 2 * tone)


def read_time(picture: Image, *, exposure_ns: int, row_time_ns: float) -> float:
    """Return when the exposure of an image's first row began, in ns within CYCLE_NS, by its LEDs' light.

    Raises PanelNotFoundError if the image shows no time.
    """
    read = read_panel(picture, exposure_ns=exposure_ns, row_time_ns=row_time_ns)
    return (read.at_row(0.0)[0] - exposure_ns / 2) % CYCLE_NS


def difference_ns(one_ns: float, other_ns: float) -> float:
    """Return `one` minus `other`, both within CYCLE_NS, as the smallest possible difference."""
    return nearest_ns(one_ns - other_ns, CYCLE_NS)
