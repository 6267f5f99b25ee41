"""A rendered panel of LEDs that shows the time, after the paper's (section 5): 10x10 LEDs and a row of ten.

Of the 10x10 one column is lit for `tau`, then the next; in the row below each LED is lit for ten `tau`.
Together they tell the true time modulo 100 `tau`. A pixel is as bright as its LED was lit during its row's
exposure.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray

from capture_app.simulation.sensor import SensorFrame

if TYPE_CHECKING:
    from capture_app.session.calibration import CameraCalibration

COLUMNS = 10
ROWS = 10
LEDS = 2 * COLUMNS
"""Numbers of LEDs that light differently: 0 to 9 the columns, 10 to 19 the row of ten."""
BOTTOM_ROW_AT = 10.7
"""Where the row of ten is, counted in LEDs from the first row."""
DARK, BRIGHT = 14.0, 226.0
"""Grey levels of an LED that is off, and what it gains where it is lit all the exposure."""
_NOISE = 1.5
_WIDTH, _HEIGHT = 640, 480
_COLOUR = np.array([0.42, 0.55, 1.0], np.float32)

VIEWS = {"cam00": (0.0, (0.0, 0.0)), "cam01": (-2.5, (-14.0, 6.0))}
"""Tilt in degrees and shift in px of the views by name; any other view is straight."""

Floats = NDArray[np.float32]


@dataclass(frozen=True)
class PanelView:
    """A camera's view of the panel; `tilt` turns the picture by so many degrees, `shift` in px."""

    tau_ns: int = 200_000
    row_time_ns: int = 10_000
    tilt_deg: float = 0.0
    shift: tuple[float, float] = (0.0, 0.0)
    scale: float = 1.0

    @property
    def width(self) -> int:
        """Width in pixels."""
        return round(_WIDTH * self.scale)

    @property
    def height(self) -> int:
        """Height in pixels."""
        return round(_HEIGHT * self.scale)

    @property
    def calibration(self) -> CameraCalibration | None:
        """None: the panel is flat and nobody measures depth on it."""
        return None

    def render(self, frame: SensorFrame, *, seed: int) -> NDArray[np.uint8]:
        """Return the picture, BGR uint8 of height x width x 3; grey levels are linear in light."""
        starts_ns = frame.start_true_ns + self.row_time_ns * np.arange(self.height, dtype=np.int64)
        lit = lit_share(starts_ns, frame.exposure_ns, self.tau_ns)
        led, weight, board = _drawn(self)
        share = np.take_along_axis(lit, led, axis=1)
        light = board + (weight * (DARK + BRIGHT * share))[..., None] * _COLOUR
        rng = np.random.default_rng([seed % 2**64, frame.start_true_ns % 2**64])
        light = light + _NOISE * rng.standard_normal(light.shape, dtype=np.float32)
        return np.asarray(np.clip(np.rint(light), 0, 255), np.uint8)

    def ground_truth(
        self, frame: SensorFrame
    ) -> tuple[NDArray[np.float32], NDArray[np.uint8], NDArray[np.bool_]]:
        """Return arrays that say that the panel has no depth, no objects and nothing that moves."""
        shape = (self.height, self.width)
        return np.zeros(shape, np.float32), np.zeros(shape, np.uint8), np.zeros(shape, np.bool_)

    def led_centres(self) -> Floats:
        """Where the LEDs are in the picture, in px: (ROWS + 1, COLUMNS, 2), the row of ten last."""
        rows = np.array([*range(ROWS), BOTTOM_ROW_AT])
        x, y = np.meshgrid(np.arange(COLUMNS), rows)
        places = np.stack([x, y, np.ones_like(x, float)], axis=-1) @ self._image_from_panel().T
        return np.asarray(places[..., :2], np.float32)

    def _image_from_panel(self) -> NDArray[np.float64]:
        """Similarity (3, 3) from places counted in LEDs to pixels."""
        pitch = 36.0 * self.scale
        angle = np.radians(self.tilt_deg)
        turn = pitch * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        middle = np.array([(COLUMNS - 1) / 2, BOTTOM_ROW_AT / 2])
        centre = np.array([self.width - 1, self.height - 1]) / 2 + np.array(self.shift) * self.scale
        matrix = np.eye(3)
        matrix[:2, :2] = turn
        matrix[:2, 2] = centre - turn @ middle
        return matrix


def lit_share(starts_ns: NDArray[np.int64], exposure_ns: int, tau_ns: int) -> Floats:
    """Share of each exposure (N) during which each LED was lit: (N, LEDS), columns first."""
    numbers = np.arange(COLUMNS)
    shares = []
    for step_ns in (tau_ns, COLUMNS * tau_ns):
        after, before = (_lit_until(starts_ns + late_ns, numbers, step_ns) for late_ns in (exposure_ns, 0))
        shares.append((after - before) / exposure_ns)
    return np.concatenate(shares, axis=1).astype(np.float32)


def _lit_until(times_ns: NDArray[np.int64], numbers: NDArray[np.int_], step_ns: int) -> NDArray[np.int64]:
    """How long each LED (columns) was lit in all until each time (rows), in ns."""
    turn, within = np.divmod(times_ns, COLUMNS * step_ns)
    return turn[:, None] * step_ns + np.clip(within[:, None] - numbers * step_ns, 0, step_ns)


@functools.lru_cache(maxsize=16)
def _drawn(view: PanelView) -> tuple[NDArray[np.intp], Floats, Floats]:
    """For each pixel its LED's number, how much of its light it gets, and the board's own colour."""
    y, x = np.mgrid[: view.height, : view.width].astype(np.float64)
    panel = np.stack([x, y, np.ones_like(x)], axis=-1) @ np.linalg.inv(view._image_from_panel()).T
    column = np.clip(np.rint(panel[..., 0]), 0, COLUMNS - 1)
    row = np.clip(np.rint(panel[..., 1]), 0, ROWS - 1)
    bottom = panel[..., 1] > (ROWS - 1 + BOTTOM_ROW_AT) / 2
    row = np.where(bottom, BOTTOM_ROW_AT, row)
    away = np.hypot(panel[..., 0] - column, panel[..., 1] - row)
    disc = np.clip((0.36 - away) / 0.05 + 0.5, 0, 1)
    glow = 0.14 * np.exp(-np.maximum(away - 0.3, 0) / 0.12)
    led = (column + COLUMNS * bottom).astype(np.intp)
    middle = np.array([(COLUMNS - 1) / 2, BOTTOM_ROW_AT / 2])
    half = np.array([COLUMNS / 2 + 0.35, BOTTOM_ROW_AT / 2 + 0.85])
    inside = (np.abs(panel[..., :2] - middle) < half).all(axis=-1)
    board = np.where(inside[..., None], (26.0, 30.0, 22.0), (58.0, 64.0, 70.0)).astype(np.float32)
    board = cv2.GaussianBlur(board, (0, 0), 0.8)
    weight = np.where(inside, np.maximum(disc, glow), 0.0).astype(np.float32)
    return led, weight, np.asarray(board, np.float32)
