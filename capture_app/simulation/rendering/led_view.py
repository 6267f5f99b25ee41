"""A simulated camera's view of the paper's LED panel."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from capture_app.simulation.rendering import led_panel
from capture_app.simulation.rendering.picture_source import no_ground_truth

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from capture_app.session.format.calibration import CameraCalibration
    from capture_app.simulation.devices.sensor import SensorFrame
    from capture_app.simulation.rendering.picture_source import GroundTruthArrays

_SHARES = (0.42, 0.55)
"""Blue and green of the LEDs' light, which is orange; red is the light as the panel's reader wants it."""
_WALL, _BACK, _LENS = (38.0, 34.0), (18.0, 16.0), (27.0, 25.0)
"""Blue and green of the wall, the panel and LEDs that are not lit."""


@functools.cache
def _board() -> NDArray[np.float32]:
    """Blue and green (H, W, 2) of everything that does not shine."""
    import cv2

    picture = np.full((led_panel.HEIGHT, led_panel.WIDTH, 2), _WALL, np.float32)
    x, y = np.array([[led.x, led.y] for led in led_panel.LEDS]).T
    edge = led_panel.PITCH
    corners = [round(v) for v in (x.min() - edge, y.min() - edge, x.max() + edge, y.max() + edge)]
    cv2.rectangle(picture, corners[:2], corners[2:], _BACK, -1)
    for led in led_panel.LEDS:
        cv2.circle(picture, (round(led.x), round(led.y)), 7, _LENS, -1, cv2.LINE_AA)
    return picture


@dataclass(frozen=True, slots=True)
class PanelView:
    """The panel from straight before it, read out row by row."""

    row_time_ns: int
    width: int = led_panel.WIDTH
    height: int = led_panel.HEIGHT

    @property
    def calibration(self) -> CameraCalibration | None:
        """None: a flat panel has no depth to measure."""
        return None

    def render(self, frame: SensorFrame, *, seed: int) -> NDArray[np.uint8]:
        """Return the picture, BGR uint8 of height x width x 3; its red is what `read_time` reads."""
        rng = np.random.default_rng([seed % 2**64, frame.start_true_ns % 2**64])
        red = led_panel.render(
            frame.start_true_ns, exposure_ns=frame.exposure_ns, row_time_ns=self.row_time_ns, rng=rng
        )
        board = _board()
        blue, green = (np.clip(board[..., n] + _SHARES[n] * red, 0, 255) for n in (0, 1))
        return np.stack([blue.astype(np.uint8), green.astype(np.uint8), red], axis=-1)

    def ground_truth(self, frame: SensorFrame) -> GroundTruthArrays:
        """Return arrays of zeros: the panel has no depth, no objects and nothing that moves."""
        return no_ground_truth(self.height, self.width)
