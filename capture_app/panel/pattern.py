"""What a panel shows at which time: lamps that are lit by turns, between markers that say which panel it is.

The layout is the paper's (section 6.1): an array of 10 x 10 lamps of which one column is lit for a tick and
then the next, and rows of 10 lamps, each lit ten times as long as those above. Lamps are LEDs, or cells of a
screen whose tick is a refresh. Lengths are in pitches of the array, x to the right and y down from the
frame's corner.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from typing import Any, Literal

from capture_app.common.errors import BadInputError

COUNT = 10
"""Columns and rows of an array; a digit of the time has so many values."""
DICTIONARY = "4X4_250"
MARKER_SIZE = 3.0
MARKER_MODULES = 6
"""Squares across a marker, its black border included."""
_MARGIN = 0.5
"""White around markers, which is one of their squares."""
_SIDE = 5.0
"""The way from the frame's edge to the first column: room for a marker."""
_TOP = 1.25
_ROW_STEP = 1.5
_DARK_EDGE = 0.75
"""The way from the outer lamps to the edge of the dark ground behind them."""
_ARRAY_STEP = 11.5
"""The way from the first column of an array to that of the next."""
SCAN_SHARE = 0.9
"""Share of a refresh in which a screen draws from one edge of the panel to the other."""


Scan = Literal["none", "down", "right", "up", "left"]
"""The way in which a screen draws a refresh over the panel; a panel of LEDs has none."""
RATES_HZ = (30, 50, 60, 72, 75, 90, 100, 120, 144, 165, 240)
"""Refresh rates of screens that markers can tell."""
RATE_TOLERANCE = 0.03
"""A screen's rate may differ by this share from the one its markers tell (59.94 Hz is 60)."""
_FIRST_MARKER = 50
"""Lower numbers are on the usual calibration board, which may stand in the same picture."""
_MARKERS = 4
_LED_KINDS = 6
"""Room for panels of LEDs before those of screens."""


@dataclass(frozen=True, slots=True)
class Lamp:
    """A lamp: lit while (tick - start) mod period is less than `lit`; one of a group that is lit by turns."""

    x: float
    """The lamp's middle across, in pitches, as `y` down."""
    y: float
    group: int
    """Lamps of a group are lit by turns: at any time those of one start."""
    start: int
    """The tick at which the lamp lights up first; `lit` and `period` are in ticks too."""
    lit: int
    period: int
    delay: float
    """It shows its light so many ticks later than the panel's middle, as a screen draws edge by edge."""

    def is_lit(self, tick: int) -> bool:
        """Whether it is lit in that tick, by the panel's own time."""
        return (tick - self.start) % self.period < self.lit


@dataclass(frozen=True, slots=True)
class Marker:
    """A marker of the frame: its number in the dictionary and the corner of it that is its upper left."""

    number: int
    x: float
    y: float

    @property
    def corners(self) -> tuple[tuple[float, float], ...]:
        """Upper left, upper right, lower right, lower left: OpenCV's order."""
        right, bottom = self.x + MARKER_SIZE, self.y + MARKER_SIZE
        return ((self.x, self.y), (right, self.y), (right, bottom), (self.x, bottom))


@dataclass(frozen=True, slots=True)
class Panel:
    """A panel: `name` says which, `ticks` how long each of its arrays' columns is lit (in ticks).

    Its first marker's number is `first_marker`; `rows` are the rows of lamps below each array.
    """

    name: str
    tick_ns: float
    first_marker: int
    ticks: tuple[int, ...] = (1,)
    rows: int = 1
    scan: Scan = "none"

    @property
    def is_screen(self) -> bool:
        """Whether it is shown on a screen, whose tick is a refresh."""
        return self.scan != "none"

    @property
    def lamp_size(self) -> float:
        """Diameter of an LED, or side of a screen's square cell."""
        return 0.7 if self.is_screen else 0.6

    @property
    def width(self) -> float:
        """The frame's width in pitches; the markers are in its corners."""
        return 2 * _SIDE + COUNT - 1 + (len(self.ticks) - 1) * _ARRAY_STEP

    @property
    def height(self) -> float:
        """The frame's height in pitches."""
        return 2 * _TOP + COUNT - 1 + self.rows * _ROW_STEP

    @property
    def cycle_ticks(self) -> int:
        """After so many ticks the panel shows the same again."""
        return max(self.ticks) * int(COUNT ** (self.rows + 1))

    @property
    def cycle_ns(self) -> float:
        """After so long the panel shows the same again: its times are within this."""
        return self.cycle_ticks * self.tick_ns

    @property
    def markers(self) -> tuple[Marker, ...]:
        """Upper left, upper right, lower right, lower left."""
        left = top = _MARGIN
        right, bottom = self.width - _MARGIN - MARKER_SIZE, self.height - _MARGIN - MARKER_SIZE
        places = ((left, top), (right, top), (right, bottom), (left, bottom))
        return tuple(Marker(self.first_marker + n, x, y) for n, (x, y) in enumerate(places))

    @property
    def dark(self) -> tuple[tuple[float, float, float, float], ...]:
        """Left, top, width and height of the dark grounds, one behind each array; all else is white."""
        side = COUNT - 1 + 2 * _DARK_EDGE
        return tuple(
            (left - _DARK_EDGE, _TOP - _DARK_EDGE, side, self.height - 2 * (_TOP - _DARK_EDGE))
            for left in self._lefts()
        )

    @property
    def lamps(self) -> tuple[Lamp, ...]:
        """All lamps, array by array, each column by column and then its rows."""
        return tuple(self._lamps())

    def _lefts(self) -> Iterator[float]:
        return (_SIDE + number * _ARRAY_STEP for number in range(len(self.ticks)))

    def _lamps(self) -> Iterator[Lamp]:
        for array, (left, lit) in enumerate(zip(self._lefts(), self.ticks, strict=True)):
            group = array * (self.rows + 1)
            for column in range(COUNT):
                for row in range(COUNT):
                    yield self._lamp(left + column, _TOP + row, group, column, lit)
            for row in range(1, self.rows + 1):
                y = _TOP + COUNT - 1 + row * _ROW_STEP
                for column in range(COUNT):
                    yield self._lamp(left + column, y, group + row, column, lit * COUNT**row)

    def _lamp(self, x: float, y: float, group: int, turn: int, lit: int) -> Lamp:
        across, down = x / self.width, y / self.height
        share = {
            "none": 0.5,
            "down": down,
            "up": 1 - down,
            "right": across,
            "left": 1 - across,
        }
        delay = SCAN_SHARE * (share[self.scan] - 0.5)
        return Lamp(x, y, group, turn * lit, lit, COUNT * lit, delay)

    def description(self) -> dict[str, Any]:
        """The whole panel as plain data, for pages and sketches that draw it."""
        return {
            "name": self.name,
            "tick_ns": self.tick_ns,
            "cycle_ticks": self.cycle_ticks,
            "width": self.width,
            "height": self.height,
            "scan": self.scan,
            "marker_size": MARKER_SIZE,
            "markers": [
                {
                    "number": marker.number,
                    "x": marker.x,
                    "y": marker.y,
                    "white": marker_squares(marker.number),
                }
                for marker in self.markers
            ],
            "dark": [list(ground) for ground in self.dark],
            "lamp_size": self.lamp_size,
            "lamps": [
                {"x": n.x, "y": n.y, "group": n.group, "start": n.start, "lit": n.lit, "period": n.period}
                for n in self.lamps
            ],
        }


def nearest_ns(difference_ns: float, cycle_ns: float) -> float:
    """The nearest to 0 that a difference of times may be that are known but for whole cycles."""
    return (difference_ns + cycle_ns / 2) % cycle_ns - cycle_ns / 2


def marker_squares(number: int) -> list[list[int]]:
    """Which squares of a marker are white, row by row, MARKER_MODULES x MARKER_MODULES of 0 and 1."""
    import cv2  # slow to import, and only whoever draws needs it
    import numpy as np

    words = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{DICTIONARY}"))
    picture = cv2.aruco.generateImageMarker(words, number, MARKER_MODULES, borderBits=1)
    squares: list[list[int]] = (np.asarray(picture) > 0).astype(int).tolist()
    return squares


def _led_panels() -> Iterator[Panel]:
    kinds = (
        ("led-200us", 200_000.0, (1,)),
        ("led-10ms", 10_000_000.0, (1,)),
        ("led-pair", 200_000.0, (1, 50)),
    )
    for kind, (name, tick_ns, ticks) in enumerate(kinds):
        yield Panel(name, tick_ns, _FIRST_MARKER + _MARKERS * kind, ticks)


def _screen_panels() -> Iterator[Panel]:
    scans: tuple[Scan, ...] = ("down", "right", "up", "left")
    for kind, (rate_hz, scan) in enumerate(product(RATES_HZ, scans), _LED_KINDS):
        name = f"screen-{rate_hz}hz-{scan}"
        yield Panel(name, 1e9 / rate_hz, _FIRST_MARKER + _MARKERS * kind, (1,), 2, scan)


PANELS = {panel.name: panel for panel in (*_led_panels(), *_screen_panels())}
"""All panels by their names: the paper's with ticks of 200 us or 10 ms, both side by side, and screens'."""

_BY_MARKER = {marker.number: panel for panel in PANELS.values() for marker in panel.markers}


def panel_of_marker(number: int) -> Panel | None:
    """The panel that a marker belongs to; None for markers of no panel."""
    return _BY_MARKER.get(number)


def panel_named(name: str) -> Panel:
    """The panel of that name; raises BadInputError for none."""
    if name not in PANELS:
        raise BadInputError(f"there is no panel {name!r}", hint=f"such as {', '.join(list(PANELS)[:3])}")
    return PANELS[name]
