"""Plots of a camera: phase over time as a strip, phase error histogram, and wedge of clock exchanges.

Drawn with block glyphs, which every monospaced font has; many lack braille.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from textual.content import Content

from capture_app.common.text import count, duration
from capture_app.tui.widgets.lines import bar_rows, joined_cells

QUARTERS = 2, 2, " ▘▝▀▖▌▞▛▗▚▐▜▄▙▟█"
"""Dots per cell across and down, and the glyph of each combination of four dots."""
LEVELS = 1, 3, " ▔─│▁│││"
"""Thin line at one of three heights, or a stroke through several."""
SHOWN_FRACTION = 0.98
"""Fraction of the frames that the axis spans; larger errors are counted at its ends."""
LABEL_WIDTH = 8
SHOWN_TRIPS_FRACTION = 0.95
"""Fraction of exchanges shown, shortest first: a few long ones would compress the rest into a line."""
MEASURABLE_NS = 1000
"""Round trips below this are labelled 0: they measure clock reads, not the network."""
EDGE = "$foreground 30%"
SPAN_S = 30.0
TYPICAL_TOLERANCE_NS = 100_000
TYPICAL_PERIOD_NS = 33_333_333
EMPTY = " ┈"
"""Cells without a trace: blank, and a line in the middle of the band."""
AXIS_WIDTH = 7
"""Cells of the axis labels."""


class Canvas:
    """Grid of dots, several per cell; (0, 0) is at the top left."""

    def __init__(self, width: int, height: int, of: tuple[int, int, str]) -> None:
        """`width` and `height` in cells; `of` is QUARTERS or LEVELS."""
        self._across, self._down, self._glyphs = of
        self.dots = self._across * width, self._down * height
        """Number of dots across and down."""
        self._cells = [[0] * width for _ in range(height)]

    def put(self, x: int, y: int) -> None:
        """Set a dot; outside the grid, do nothing."""
        if 0 <= x < self.dots[0] and 0 <= y < self.dots[1]:
            place = self._across * (y % self._down) + x % self._across
            self._cells[y // self._down][x // self._across] |= 1 << place

    def row(self, y: int, empty: str = " ") -> str:
        """Return a row of cells as text, `empty` where no dot is set."""
        return "".join(self._glyphs[marks] if marks else empty for marks in self._cells[y])


def histogram_rows(errors_ns: Sequence[int], tolerance_ns: int, width: int, height: int) -> list[Content]:
    """Draw the histogram of phase errors; bars within the tolerance have another colour."""
    if not errors_ns or width < 12 or height < 3:
        return [Content.styled("No frame on the grid yet.", "$foreground-muted")]
    sizes = sorted(abs(error) for error in errors_ns)
    limit = max(1.25 * tolerance_ns, sizes[int(SHOWN_FRACTION * (len(sizes) - 1))], 1.0)
    bins = [0] * width
    for error in errors_ns:
        bins[max(0, min(int((error / limit + 1) / 2 * width), width - 1))] += 1
    # A non-empty bar is at least an eighth of a cell high.
    eighths = [max(round(8 * (height - 1) * size / max(bins)), 1) if size else 0 for size in bins]
    inside = [abs((x + 0.5) / width * 2 - 1) * limit <= tolerance_ns for x in range(width)]
    styles = ["$success on $success 9%" if each else "$warning" for each in inside]
    rows = [joined_cells(zip(row, styles, strict=True)) for row in bar_rows(eighths, height - 1)]
    axis = _foot(f"−{duration(limit)}", "0", duration(limit, signed=True), width)
    return [*rows, Content.styled(axis[:width], "$foreground-muted")]


def _foot(left: str, middle: str, right: str, width: int) -> str:
    """Return the labels below an axis, at its ends and its middle."""
    gap = max(width - len(left) - len(right) - len(middle), 2)
    return left + " " * (gap // 2) + middle + " " * (gap - gap // 2) + right


def histogram_title(errors_ns: Sequence[int], tolerance_ns: int) -> str:
    """Return the title of the histogram."""
    if not errors_ns:
        return "phase error"
    fraction = sum(abs(error) <= tolerance_ns for error in errors_ns) / len(errors_ns)
    return f"phase, {100 * fraction:.0f} % of {len(errors_ns)} within ±{duration(tolerance_ns)}"


def wedge_rows(samples_ns: Sequence[tuple[int, int]], width: int, height: int) -> list[Content]:
    """Draw clock offsets, relative to the shortest exchanges, over round trips, with their bounds.

    An exchange whose round trip exceeds the shortest by r has an error of at most ± r/2.
    """
    if len(samples_ns) < 2 or width <= LABEL_WIDTH + 4 or height < 3:
        return [Content.styled("No exchanges with the leader yet.", "$foreground-muted")]
    by_round_trip = sorted(samples_ns, key=lambda sample: sample[1])
    shown = by_round_trip[: max(2, round(SHOWN_TRIPS_FRACTION * len(by_round_trip)))]
    shortest, longest = shown[0][1], max(shown[-1][1], shown[0][1] + 1)
    best = sorted(offset for offset, _ in by_round_trip[: max(1, len(by_round_trip) // 20)])
    middle = best[len(best) // 2]
    limit = max((longest - shortest) / 2, *(abs(offset - middle) for offset, _ in shown), 1.0)
    points, edges = (Canvas(width - LABEL_WIDTH, height - 1, QUARTERS) for _ in range(2))
    across, down = points.dots

    def row_of(offset: float) -> int:
        return round((1 - offset / limit) / 2 * (down - 1))

    for x in range(across):
        half = (longest - shortest) * x / (across - 1) / 2
        edges.put(x, row_of(half))
        edges.put(x, row_of(-half))
    for offset, round_trip in shown:
        x = round((round_trip - shortest) / (longest - shortest) * (across - 1))
        points.put(x, row_of(offset - middle))
    labels = {0: duration(limit, signed=True), (height - 1) // 2: "0", height - 2: f"−{duration(limit)}"}
    rows: list[Content] = []
    for y in range(height - 1):
        label = f"{labels.get(y, '')[: LABEL_WIDTH - 1]:>{LABEL_WIDTH - 1}} "
        cells = (
            (dot, "$primary") if dot != " " else (edge, EDGE)
            for dot, edge in zip(points.row(y), edges.row(y), strict=True)
        )
        rows.append(Content.styled(label, "$foreground-muted") + joined_cells(cells))
    left = duration(shortest) if shortest >= MEASURABLE_NS else "0"
    foot = _foot(left, "round trip", duration(longest), width - LABEL_WIDTH)
    return [*rows, Content.styled(" " * LABEL_WIDTH + foot, "$foreground-muted")]


def wedge_title(samples_ns: Sequence[tuple[int, int]]) -> str:
    """Return the title of the wedge plot."""
    return f"clock offset, {count(len(samples_ns), 'exchange')}" if samples_ns else "clock"


@dataclass(frozen=True, slots=True)
class PhaseAxis:
    """Common phase axis of a rig's cameras, -limit to +limit: a linear band, logarithmic outside."""

    tolerance_ns: int
    """Half width of the band, in ns; > 0."""
    limit_ns: int
    """End of the axis, in ns; more than the tolerance."""

    @classmethod
    def of(cls, tolerances_ns: Sequence[int], period_ns: int | None) -> "PhaseAxis":
        """Return a rig's axis: the widest tolerance is the band, half a period the end."""
        tolerance = max((ns for ns in tolerances_ns if ns > 0), default=TYPICAL_TOLERANCE_NS)
        return cls(tolerance, max((period_ns or TYPICAL_PERIOD_NS) // 2, 2 * tolerance))

    def __str__(self) -> str:
        """Return the values of the band and of the ends."""
        return f"band ±{duration(self.tolerance_ns)} · ends ±{duration(self.limit_ns)}"

    def place(self, error_ns: float, band: float) -> float:
        """Return an error's position: from 0 (-limit) to 1 (+limit); `band` is the part within tolerance."""
        size = min(abs(error_ns), self.limit_ns)
        if size <= self.tolerance_ns:
            distance = band / 2 * size / self.tolerance_ns
        else:
            beyond = math.log(size / self.tolerance_ns) / math.log(self.limit_ns / self.tolerance_ns)
            distance = band / 2 + (0.5 - band / 2) * beyond
        return 0.5 + math.copysign(distance, error_ns)

    def labels(self, height: int) -> list[str]:
        """Return the labels beside the rows of a strip."""
        labels = [""] * height
        if height > 1:
            labels[0] = f"┐{duration(self.limit_ns, signed=True, gap='')}"
            labels[height // 2] = f"┤±{duration(self.tolerance_ns, gap='')}"
            labels[-1] = f"┘{duration(-self.limit_ns, gap='').replace('-', '−')}"
        return labels


def band_rows(height: int) -> int:
    """Return the number of rows of the band, which is in the middle of the strip."""
    return 3 if height >= 7 else 1


def band_fraction(height: int) -> float:
    """Return the band's fraction of a strip: whole rows, or the middle third of a single row."""
    return band_rows(height) / height if height > 1 else 1 / 3


def times_of(width: int, now_s: float) -> list[float]:
    """Return the times (s) of the `width` cells of a plot that ends at `now_s`, on a fixed grid."""
    step = SPAN_S / width
    end = int(now_s / step) + 1
    return [n * step for n in range(end - width, end)]


def strip_rows(
    errors_ns: Sequence[int | None], axis: PhaseAxis, *, width: int, height: int, dimmed: bool
) -> list[Content]:
    """Draw the errors, one per cell across; `dimmed` for a lost camera."""
    trace, band = Canvas(width, height, LEVELS), band_fraction(height)
    levels = trace.dots[1]
    before: int | None = None
    for x, error in enumerate(errors_ns):
        y = None
        if error is not None:
            begin = y = min(int((1 - axis.place(error, band)) * levels), levels - 1)
            # A jump over half of the axis is a phase that wrapped around, so the points are not joined.
            if before is not None and abs(y - before) <= levels // 2:
                begin = before + (y > before) - (y < before)
            for level in range(min(begin, y), max(begin, y) + 1):
                trace.put(x, level)
        before = y
    if height == 1:
        newest = next((error for error in reversed(errors_ns) if error is not None), None)
        in_band = [newest is not None and abs(newest) <= axis.tolerance_ns]
    else:
        in_band = [abs(y - height // 2) <= band_rows(height) // 2 for y in range(height)]
    rows: list[Content] = []
    for y, inside in enumerate(in_band):
        style = "$foreground-muted" if dimmed else "$success" if inside else "$warning"
        empty = EMPTY[y == height // 2]
        cells = ((each, "$foreground 25%" if each == empty else style) for each in trace.row(y, empty))
        tint = "on $success 9%" if inside and not dimmed and height > 1 else ""
        rows.append(joined_cells(cells).stylize_before(tint))
    return rows
