"""A camera's phase error over the last half minute, as a trace that is watched going into the band."""

from collections.abc import Sequence
from dataclasses import dataclass

from textual.content import Content

from capture_app.text import duration
from capture_app.tui.drawing.dots import TraceCanvas
from capture_app.tui.drawing.scales import BandScale

SPAN_S = 30.0
USUAL_TOLERANCE_NS = 100_000
USUAL_PERIOD_NS = 33_333_333
EMPTY = " ┈"
"""Where there is no trace: nothing, and the middle of the band."""
AXIS_WIDTH = 7
"""Cells that the labels of the axis take."""


@dataclass(frozen=True, slots=True)
class PhaseAxis:
    """The one axis of all cameras of a rig; in ns."""

    tolerance_ns: int
    limit_ns: int

    @classmethod
    def of(cls, tolerances_ns: Sequence[int], period_ns: int | None) -> "PhaseAxis":
        """The axis for a rig: the widest tolerance is the band, half a period the end."""
        tolerance = max((ns for ns in tolerances_ns if ns > 0), default=USUAL_TOLERANCE_NS)
        return cls(tolerance, max((period_ns or USUAL_PERIOD_NS) // 2, 2 * tolerance))

    def __str__(self) -> str:
        """What a strip's band and ends are, in a line."""
        return f"band ±{duration(self.tolerance_ns)} · ends ±{duration(self.limit_ns)}"

    def scale(self, height: int) -> BandScale:
        """The scale for a strip of so many rows: its band fills whole rows, or the middle of one."""
        return BandScale(
            self.tolerance_ns, self.limit_ns, band_rows(height) / height if height > 1 else 1 / 3
        )

    def labels(self, height: int) -> list[str]:
        """The text beside each row of a strip."""
        labels = [""] * height
        if height > 1:
            labels[0] = f"┐{duration(self.limit_ns, signed=True, gap='')}"
            labels[height // 2] = f"┤±{duration(self.tolerance_ns, gap='')}"
            labels[-1] = f"┘{duration(-self.limit_ns, gap='').replace('-', '−')}"
        return labels


def band_rows(height: int) -> int:
    """How many rows of a strip are the band, in its middle."""
    return 3 if height >= 7 else 1


def times_of(width: int, now_s: float) -> list[float]:
    """The moments that the cells of a strip stand for, on a grid that does not move."""
    step = SPAN_S / width
    last = int(now_s / step)
    return [(last - width + 1 + n) * step for n in range(width)]


def strip_rows(
    errors_ns: Sequence[int | None], axis: PhaseAxis, *, width: int, height: int, dimmed: bool
) -> list[Content]:
    """Draw the errors, one for each cell across; `dimmed` for a camera that is gone."""
    trace = TraceCanvas(width, height)
    scale = axis.scale(height)
    before: int | None = None
    for x, error in enumerate(errors_ns):
        y = None if error is None else min(int((1 - scale.place(error)) * trace.levels), trace.levels - 1)
        if y is not None:
            # A jump over half of the axis is a phase that went around, not one that passed all between.
            joined = before is not None and abs(y - before) <= trace.levels // 2
            begin = y if before is None or not joined else before + (y > before) - (y < before)
            trace.put(x, begin, y)
        before = y
    if height == 1:
        newest = next((error for error in reversed(errors_ns) if error is not None), None)
        inside = newest is not None and abs(newest) <= axis.tolerance_ns
        style = "$foreground-muted" if dimmed else "$success" if inside else "$warning"
        return [_dimmable(trace.row(0, EMPTY[1]), style, "$foreground 25%")]
    middle = height // 2
    half = band_rows(height) // 2
    rows: list[Content] = []
    for y in range(height):
        in_band = abs(y - middle) <= half
        style = "$foreground-muted" if dimmed else "$success" if in_band else "$warning"
        row = _dimmable(trace.row(y, EMPTY[1] if y == middle else EMPTY[0]), style, "$foreground 25%")
        rows.append(row.stylize_before("on $success 9%") if in_band and not dimmed else row)
    return rows


def _dimmable(text: str, style: str, line_style: str) -> Content:
    """The trace in one style, and what is drawn where it is not in another."""
    parts: list[tuple[str, str]] = []
    for character in text:
        kind = line_style if character in EMPTY else style
        if parts and parts[-1][1] == kind:
            parts[-1] = (parts[-1][0] + character, kind)
        else:
            parts.append((character, kind))
    return Content.assemble(*parts)
