"""The paper's LED panel (section 6.1) as simulated cameras see it, and the time read off their pictures.

Two panels stand side by side: with a tick of 200 us a picture gives its time to microseconds within 20 ms,
with 10 ms to a millisecond within a second. The reader is told nothing of the panel or of where it stands.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from capture_app.panel.catalog import panel_named
from capture_app.panel.pattern import nearest_ns
from capture_app.panel.reading.time_reading import read_panel
from capture_app.simulation.devices.sensor import SensorFrame
from capture_app.simulation.rendering.panel_photograph import Photograph
from capture_app.simulation.rendering.picture_source import PictureSource

WIDTH, HEIGHT = 640, 480
PANEL = panel_named("led-pair")
CYCLE_NS = round(PANEL.cycle_ns)
"""Pictures tell their time within this: 1 s."""
_CORNERS = ((27.0, 108.0), (611.0, 92.0), (620.0, 379.0), (19.0, 366.0))
"""Where the frame is seen, from a little to one side."""
UNEVEN = 0.05
"""LEDs differ in brightness by this (standard deviation)."""

Image = NDArray[np.uint8]


def render(
    start_ns: int, *, exposure_ns: int, row_time_ns: float, rng: np.random.Generator, true_ppm: float = 0.0
) -> Image:
    """Return the picture (HEIGHT x WIDTH x 3, BGR) whose first row's exposure starts at `start_ns`.

    Each row is exposed `row_time_ns` after the one above it, for `exposure_ns`; `true_ppm` is the error of
    the camera's crystal. The panel's time is 0 at 0 ns.
    """
    stretch = 1.0 + true_ppm * 1e-6
    photograph = Photograph(
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
        jpeg_quality=None,
    )
    return photograph.take(start_ns % CYCLE_NS, rng)


def read_time(picture: Image, *, exposure_ns: int, row_time_ns: float) -> float:
    """Return when the exposure of a picture's first row began, in ns within CYCLE_NS, by its LEDs' light.

    Raises PanelNotFoundError where the picture tells no time.
    """
    read = read_panel(picture, exposure_ns=exposure_ns, row_time_ns=row_time_ns)
    return (read.at_row(0.0)[0] - exposure_ns / 2) % CYCLE_NS


def difference_ns(one_ns: float, other_ns: float) -> float:
    """Return `one` minus `other`, both within CYCLE_NS, as the nearest of what it can be."""
    return nearest_ns(one_ns - other_ns, CYCLE_NS)


@dataclass(frozen=True, slots=True)
class PanelView(PictureSource):
    """A simulated camera's view of the panel, read out row by row."""

    width: int = WIDTH
    height: int = HEIGHT
    row_time_ns: int = field(kw_only=True)

    def render(self, frame: SensorFrame, *, seed: int) -> Image:
        """Return the picture, BGR uint8 of height x width x 3."""
        rng = np.random.default_rng([seed % 2**64, frame.start_true_ns % 2**64])
        return render(
            frame.start_true_ns, exposure_ns=frame.exposure_ns, row_time_ns=self.row_time_ns, rng=rng
        )
