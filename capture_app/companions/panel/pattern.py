"""Pattern of a panel: which lamps are lit at which tick, and the markers that identify the panel.

The layout is the paper's (section 6.1). An array of 10 x 10 lamps lights one column per tick, in turn. Rows
of 10 lamps follow below it; each lamp is lit ten times as long as a lamp in the row above. Lamps are LEDs, or
cells of a screen whose tick is a refresh. Lengths are in pitches of the array, x to the right and y down from
the frame's corner.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from typing import Any, Literal

COUNT = 10
"""Columns and rows of an array; also the number of values of a digit of the time."""
DICTIONARY = "4X4_250"
MARKER_SIZE = 3.0
MARKER_MODULES = 6
"""Squares across a marker, including its black border."""
_MARGIN = 0.5
"""White margin around markers, one marker square wide."""
_SIDE = 5.0
"""Distance from the frame's edge to the first column; leaves room for a marker."""
_TOP = 1.25
_ROW_STEP = 1.5
_DARK_EDGE = 0.75
"""Distance from the outer lamps to the edge of the dark ground behind them."""
_ARRAY_STEP = 11.5
"""Distance between the first columns of neighbouring arrays."""
SCAN_FRACTION = 0.9
"""Fraction of a refresh in which a screen draws from one edge of the panel to the other."""


Scan = Literal["none", "down", "right", "up", "left"]
"""Direction in which a screen draws a refresh over the panel; "none" for LEDs."""
SCANS: tuple[Scan, ...] = ("down", "right", "up", "left")
RATES_HZ = (30, 50, 60, 72, 75, 90, 100, 120, 144, 165, 240)
"""Refresh rates of screens that have their own markers."""
RATE_TOLERANCE = 0.03
"""Maximum relative difference of a screen's rate from its markers' rate (59.94 Hz counts as 60)."""
_FIRST_MARKER = 50
"""First marker number; the usual calibration board uses lower ones and may be in the same image."""
_MARKERS = 4
_LED_KINDS = 6
"""Marker numbers reserved for LED panels, in panels; screen panels follow."""


@dataclass(frozen=True, slots=True)
class Lamp:
    """One lamp of a group; lit while (tick - start) mod period is less than `lit`."""

    x: float
    """Centre of the lamp across, in pitches; `y` is down."""
    y: float
    group: int
    """Group number; the lamps of a group light in turn, and those with equal `start` together."""
    start: int
    """First tick at which the lamp is lit; `lit` and `period` are in ticks too."""
    lit: int
    period: int
    delay: float
    """Delay of its light against the panel's centre, in ticks, because a screen draws from edge to edge."""


@dataclass(frozen=True, slots=True)
class Panel:
    """Panel definition; `ticks` is each array's duration of a lit column, in ticks.

    `first_marker` is the number of its first marker; `rows` counts the rows of lamps below each array.
    """

    name: str
    tick_ns: float
    first_marker: int
    ticks: tuple[int, ...] = (1,)
    rows: int = 1
    scan: Scan = "none"

    @property
    def is_screen(self) -> bool:
        """Whether it is drawn on a screen, whose tick is a refresh."""
        return self.scan != "none"

    @property
    def lamp_size(self) -> float:
        """Diameter of an LED, or side of a screen's square cell."""
        return 0.7 if self.is_screen else 0.6

    @property
    def width(self) -> float:
        """Width of the frame in pitches; the markers are in its corners."""
        return 2 * _SIDE + COUNT - 1 + (len(self.ticks) - 1) * _ARRAY_STEP

    @property
    def height(self) -> float:
        """Height of the frame in pitches."""
        return 2 * _TOP + COUNT - 1 + self.rows * _ROW_STEP

    @property
    def cycle_ticks(self) -> int:
        """Number of ticks after which the pattern repeats."""
        return max(self.ticks) * int(COUNT ** (self.rows + 1))

    @property
    def cycle_ns(self) -> float:
        """Duration after which the pattern repeats; panel times are modulo this."""
        return self.cycle_ticks * self.tick_ns

    @property
    def markers(self) -> tuple[tuple[int, float, float], ...]:
        """Number in the dictionary, left and top of each marker, in the order of `corners_of_marker`."""
        right, bottom = self.width - _MARGIN - MARKER_SIZE, self.height - _MARGIN - MARKER_SIZE
        places = ((_MARGIN, _MARGIN), (right, _MARGIN), (right, bottom), (_MARGIN, bottom))
        return tuple((self.first_marker + n, x, y) for n, (x, y) in enumerate(places))

    @property
    def dark(self) -> tuple[tuple[float, float, float, float], ...]:
        """Left, top, width and height of the dark ground behind each array; the rest is white."""
        top, side = _TOP - _DARK_EDGE, COUNT - 1 + 2 * _DARK_EDGE
        return tuple((left - _DARK_EDGE, top, side, self.height - 2 * top) for left in self._lefts())

    @property
    def lamps(self) -> tuple[Lamp, ...]:
        """All lamps, array by array: each array's columns, then its rows."""
        return tuple(self._lamps())

    def _lefts(self) -> Iterator[float]:
        return (_SIDE + number * _ARRAY_STEP for number in range(len(self.ticks)))

    def _lamps(self) -> Iterator[Lamp]:
        for array, (left, lit) in enumerate(zip(self._lefts(), self.ticks, strict=True)):
            group = array * (self.rows + 1)
            for column, row in product(range(COUNT), repeat=2):
                yield self._lamp(left + column, _TOP + row, group, column, lit)
            for row, column in product(range(1, self.rows + 1), range(COUNT)):
                y = _TOP + COUNT - 1 + row * _ROW_STEP
                yield self._lamp(left + column, y, group + row, column, lit * COUNT**row)

    def _lamp(self, x: float, y: float, group: int, index: int, lit: int) -> Lamp:
        across, down = x / self.width, y / self.height
        position = {"none": 0.5, "down": down, "up": 1 - down, "right": across, "left": 1 - across}
        return Lamp(
            x,
            y,
            group,
            start=index * lit,
            lit=lit,
            period=COUNT * lit,
            delay=SCAN_FRACTION * (position[self.scan] - 0.5),
        )

    def description(self) -> dict[str, Any]:
        """Return the panel as plain data for the page and the sketch that draw it."""
        return {
            "name": self.name,
            "tick_ns": self.tick_ns,
            "cycle_ticks": self.cycle_ticks,
            "width": self.width,
            "height": self.height,
            "scan": self.scan,
            "marker_size": MARKER_SIZE,
            "markers": [
                {"number": number, "x": x, "y": y, "white": marker_squares(number)}
                for number, x, y in self.markers
            ],
            "dark": [list(ground) for ground in self.dark],
            "lamp_size": self.lamp_size,
            "lamps": [
                {"x": n.x, "y": n.y, "group": n.group, "start": n.start, "lit": n.lit, "period": n.period}
                for n in self.lamps
            ],
        }


def nearest_ns(difference_ns: float, cycle_ns: float) -> float:
    """Return the representative nearest to 0 of a time difference known modulo a cycle."""
    return (difference_ns + cycle_ns / 2) % cycle_ns - cycle_ns / 2


def corners_of_marker(left: float, top: float) -> tuple[tuple[float, float], ...]:
    """Return a marker's corners in OpenCV's order: upper left, upper right, lower right, lower left."""
    right, bottom = left + MARKER_SIZE, top + MARKER_SIZE
    return ((left, top), (right, top), (right, bottom), (left, bottom))


def marker_squares(number: int) -> list[list[int]]:
    """Return a marker's white squares, row by row, MARKER_MODULES x MARKER_MODULES of 0 and 1."""
    import cv2  # slow to import, and needed only for drawing
    import numpy as np

    words = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{DICTIONARY}"))
    picture = cv2.aruco.generateImageMarker(words, number, MARKER_MODULES, borderBits=1)
    return list((np.asarray(picture) > 0).astype(int).tolist())


def _panels() -> Iterator[Panel]:
    yield Panel("led-200us", 200_000.0, _FIRST_MARKER)
    yield Panel("led-10ms", 10_000_000.0, _FIRST_MARKER + _MARKERS)
    yield Panel("led-pair", 200_000.0, _FIRST_MARKER + 2 * _MARKERS, (1, 50))
    for kind, (rate_hz, scan) in enumerate(product(RATES_HZ, SCANS), _LED_KINDS):
        yield Panel(
            f"screen-{rate_hz}hz-{scan}", 1e9 / rate_hz, _FIRST_MARKER + _MARKERS * kind, rows=2, scan=scan
        )


PANELS = {panel.name: panel for panel in _panels()}
"""All panels by name: the paper's with ticks of 200 us or 10 ms, both side by side, and screens."""

PANEL_OF_MARKER = {number: panel for panel in PANELS.values() for number, _, _ in panel.markers}
"""The panel that each marker belongs to, by the marker's number."""
