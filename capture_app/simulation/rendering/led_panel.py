"""The paper's LED panel (section 6.1) as a rolling-shutter camera sees it, and the time read off its picture.

A panel has 10 x 10 LEDs, of which one column is lit for tau and then the next, and a row of 10 LEDs, each lit
for 10 tau. Two panels stand side by side: with tau = 200 us a picture gives its time to microseconds within
20 ms, with tau = 10 ms to a millisecond within a second.
"""

import functools
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from capture_app.simulation.devices.sensor import SensorFrame
from capture_app.simulation.rendering.picture_source import PictureSource

WIDTH, HEIGHT = 640, 480
COUNT = 10
FINE_TAU_NS = 200_000
COARSE_TAU_NS = 10_000_000
CYCLE_NS = COUNT * COUNT * COARSE_TAU_NS
"""Pictures tell their time within this: 1 s."""
PITCH = 26
SPOT_SIGMA = 2.6
SPOT = 7
"""LEDs are spots of this sigma and reach, in pixels."""
MIDDLE = 2
"""Rows on each side of an LED's middle that its time is read from."""
LIGHT, DARK, NOISE = 200.0, 9.0, 2.0
"""Levels of a lit LED and of the room, and the noise of a pixel, of 255."""
UNEVEN = 0.05
"""LEDs differ in brightness by this (standard deviation)."""
_CORNERS = ((40.0, 80.0), (350.0, 80.0))
_ROW_BELOW = 11.2
_SHARES = (0.42, 0.55)
"""Blue and green of the LEDs' light, which is orange; red is the light as the panel's reader wants it."""
_WALL, _BACK, _LENS = (38.0, 34.0), (18.0, 16.0), (27.0, 25.0)
"""Blue and green of the wall, the panel and LEDs that are not lit."""

Image = NDArray[np.uint8]
Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Led:
    """An LED: where it is in the picture, in pixels, and when it is lit: from `first` * `lit_ns` on."""

    x: float
    y: float
    lit_ns: int
    first: int


def _leds() -> tuple[Led, ...]:
    leds = []
    for (left, top), tau_ns in zip(_CORNERS, (FINE_TAU_NS, COARSE_TAU_NS), strict=True):
        for column in range(COUNT):
            x = left + column * PITCH
            leds += [Led(x, top + row * PITCH, tau_ns, column) for row in range(COUNT)]
            leds.append(Led(x, top + _ROW_BELOW * PITCH, COUNT * tau_ns, column))
    return tuple(leds)


LEDS = _leds()


def render(
    start_ns: int, *, exposure_ns: int, row_time_ns: float, rng: np.random.Generator, true_ppm: float = 0.0
) -> Image:
    """Return the picture (HEIGHT x WIDTH, grey) whose first row's exposure starts at `start_ns`.

    Each row is exposed `row_time_ns` after the one above it, for `exposure_ns`; `true_ppm` is the error of
    the camera's crystal. The panel's time is 0 at 0 ns.
    """
    stretch = 1.0 + true_ppm * 1e-6
    picture = np.full((HEIGHT, WIDTH), DARK)
    for led in LEDS:
        rows, columns, spot = _spot(led)
        begin_ns = start_ns % CYCLE_NS + np.arange(rows.start, rows.stop) * (row_time_ns * stretch)
        lit = lit_share(begin_ns, exposure_ns * stretch, led.lit_ns, led.first)
        bright = LIGHT * (1.0 + UNEVEN * rng.standard_normal())
        picture[rows, columns] += bright * lit[:, None] * spot
    picture += NOISE * rng.standard_normal(picture.shape)
    levels: Image = np.clip(np.rint(picture), 0, 255).astype(np.uint8)
    return levels


def read_time(picture: Image, *, exposure_ns: int, row_time_ns: float) -> float:
    """Return when the exposure of a picture's first row began, in ns within CYCLE_NS, by its LEDs' light."""
    lit_ns = np.array([led.lit_ns for led in LEDS])
    first = np.array([led.first for led in LEDS])
    rows, light = _profiles(picture)

    def best(candidates: Floats, leds: slice | NDArray[np.bool_], lines: slice) -> float:
        begin = candidates[:, None, None] + rows[leds, lines] * row_time_ns
        model = lit_share(begin, exposure_ns, lit_ns[leds, None], first[leds, None])
        misfit = ((model - light[leds, lines]) ** 2).sum(axis=(1, 2))
        return float(candidates[int(np.argmin(misfit))])

    every, middle = slice(None), slice(MIDDLE, MIDDLE + 1)
    time_ns = best(np.arange(0.0, CYCLE_NS, 1e6), lit_ns >= COARSE_TAU_NS, middle)
    # Where a led is about to hand over to the next, a coarse step may take the wrong turn.
    for turn_ns, reach_ns, step_ns, lines in (
        (COUNT * COARSE_TAU_NS, COARSE_TAU_NS, 40e3, middle),
        (COUNT * FINE_TAU_NS, 80e3, 2e3, every),
        (0, 3e3, 100.0, every),
    ):
        near = time_ns + np.arange(-reach_ns, reach_ns, step_ns)
        turns = [near + turn * turn_ns for turn in ((-1, 0, 1) if turn_ns else (0,))]
        time_ns = best(np.concatenate(turns), every, lines)
    return time_ns % CYCLE_NS


def difference_ns(one_ns: float, other_ns: float) -> float:
    """Return `one` minus `other`, both within CYCLE_NS, as the nearest of what it can be."""
    return (one_ns - other_ns + CYCLE_NS / 2) % CYCLE_NS - CYCLE_NS / 2


def lit_share(
    begin_ns: NDArray[np.floating[Any]],
    exposure_ns: float,
    lit_ns: NDArray[np.int64] | int,
    first: NDArray[np.int64] | int,
) -> Floats:
    """Share of an exposure from `begin` in which an LED is lit: one of COUNT by turns, each for `lit` ns."""

    def lit_until(time_ns: NDArray[np.floating[Any]]) -> Floats:
        turn = np.floor_divide(time_ns, COUNT * lit_ns)
        within = time_ns - turn * (COUNT * lit_ns)
        return np.asarray(turn * lit_ns + np.clip(within - first * lit_ns, 0, lit_ns))

    share: Floats = (lit_until(begin_ns + exposure_ns) - lit_until(begin_ns)) / exposure_ns
    return share


def _spot(led: Led) -> tuple[slice, slice, Floats]:
    """Rows and columns of an LED's spot, and its brightness there."""
    y, x = round(led.y), round(led.x)
    reach = np.arange(-SPOT, SPOT + 1)
    down = np.exp(-0.5 * ((y + reach - led.y) / SPOT_SIGMA) ** 2)
    across = np.exp(-0.5 * ((x + reach - led.x) / SPOT_SIGMA) ** 2)
    spot = np.asarray(down[:, None] * across[None, :])
    return slice(y - SPOT, y + SPOT + 1), slice(x - SPOT, x + SPOT + 1), spot


def _profiles(picture: Image) -> tuple[NDArray[np.int64], Floats]:
    """Rows of each LED's bright middle, and its light there, 1 for lit all the time: both LEDS x lines."""
    all_rows, all_light = [], []
    for led in LEDS:
        rows, columns, spot = _spot(led)
        middle = slice(SPOT - MIDDLE, SPOT + MIDDLE + 1)
        spot, light = spot[middle], picture[rows, columns][middle] - DARK
        all_rows.append(np.arange(rows.start, rows.stop)[middle])
        all_light.append((light * spot).sum(axis=1) / (LIGHT * (spot**2).sum(axis=1)))
    return np.array(all_rows), np.array(all_light)


@functools.cache
def _board() -> NDArray[np.float32]:
    """Blue and green (H, W, 2) of everything that does not shine."""
    picture = np.full((HEIGHT, WIDTH, 2), _WALL, np.float32)
    x, y = np.array([[led.x, led.y] for led in LEDS]).T
    edge = PITCH
    corners = [round(v) for v in (x.min() - edge, y.min() - edge, x.max() + edge, y.max() + edge)]
    cv2.rectangle(picture, corners[:2], corners[2:], _BACK, -1)
    for led in LEDS:
        cv2.circle(picture, (round(led.x), round(led.y)), 7, _LENS, -1, cv2.LINE_AA)
    return picture


@dataclass(frozen=True, slots=True)
class PanelView(PictureSource):
    """A simulated camera's view of the panel from straight before it, read out row by row."""

    width: int = WIDTH
    height: int = HEIGHT
    row_time_ns: int = field(kw_only=True)

    def render(self, frame: SensorFrame, *, seed: int) -> Image:
        """Return the picture, BGR uint8 of height x width x 3; its red is what `read_time` reads."""
        rng = np.random.default_rng([seed % 2**64, frame.start_true_ns % 2**64])
        red = render(
            frame.start_true_ns, exposure_ns=frame.exposure_ns, row_time_ns=self.row_time_ns, rng=rng
        )
        board = _board()
        blue, green = (np.clip(board[..., n] + _SHARES[n] * red, 0, 255) for n in (0, 1))
        return np.stack([blue.astype(np.uint8), green.astype(np.uint8), red], axis=-1)
