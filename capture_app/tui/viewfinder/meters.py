"""Numbers about what a camera sees, for people: focus against its recent best, light, histogram."""

from collections import deque

from textual.content import Content

from capture_app.tui.pictures.aids import Exposure

BEST_OVER_S = 10.0
"""A focus number is compared with the best of so many seconds: turning a ring there and back takes that."""
IN_FOCUS = 0.95
"""Of the best, from which on it is called in focus."""
CLIPPED = 0.01
"""Share of the pixels from which on clipping is worth a warning."""
_EIGHTHS = " ▁▂▃▄▅▆▇█"


class FocusMeter:
    """Focus numbers over time."""

    def __init__(self) -> None:
        self._values: deque[tuple[float, float]] = deque()

    def add(self, now: float, value: float) -> None:
        """Note a focus number, at a time in seconds."""
        self._values.append((now, value))
        while self._values[0][0] < now - BEST_OVER_S:
            self._values.popleft()

    @property
    def value(self) -> float | None:
        """The newest number."""
        return self._values[-1][1] if self._values else None

    @property
    def share(self) -> float | None:
        """The newest number over the best one lately."""
        best = max((value for _, value in self._values), default=0.0)
        return self._values[-1][1] / best if best > 0 else None


def focus_line(meter: FocusMeter, width: int = 24) -> Content:
    """The focus number, and how near it is to its best lately."""
    share = meter.share
    if share is None:
        return Content.styled("focus   no picture yet", "$foreground-muted")
    filled = round(share * width)
    style = "$success" if share >= IN_FOCUS else "$warning"
    return Content.assemble(
        ("focus   ", "$foreground-muted"),
        (f"{meter.value:7.3f}  ", "bold"),
        ("█" * filled, style),
        ("░" * (width - filled), "$foreground-muted"),
        (f" {share:4.0%} of the best in {BEST_OVER_S:g} s", style),
    )


def exposure_line(exposure: Exposure) -> Content:
    """How bright a picture is, and what of it is clipped."""

    def clipped(share: float, name: str, glyph: str) -> tuple[str, str]:
        warns = share >= CLIPPED
        return f"  {glyph if warns else ' '} {name} {share:.1%}", "$warning" if warns else "$foreground-muted"

    return Content.assemble(
        ("light   ", "$foreground-muted"),
        (f"{exposure.mean / 255:7.1%}", "bold"),
        clipped(exposure.shadows, "clipped black", "▼"),
        clipped(exposure.highlights, "clipped white", "▲"),
    )


def histogram_lines(exposure: Exposure, width: int, height: int) -> list[Content]:
    """The histogram, dark at the left, of so many columns and rows; square roots, so that little is seen."""
    shares = exposure.histogram
    columns = []
    for column in range(width):
        first = column * len(shares) // width
        last = max((column + 1) * len(shares) // width, first + 1)
        columns.append(max(shares[first:last]))
    most = max(columns, default=0.0) or 1.0
    eighths = [round((share / most) ** 0.5 * 8 * height) for share in columns]
    eighths = [max(value, 1) if share > 0 else 0 for value, share in zip(eighths, columns, strict=True)]
    lines = []
    for row in range(height - 1, -1, -1):
        text = "".join(_EIGHTHS[min(max(value - 8 * row, 0), 8)] for value in eighths)
        lines.append(Content.styled(text, "$primary"))
    return lines
