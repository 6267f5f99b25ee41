"""Exchanges with the leader as points: the shorter their round trip, the less their offset can err."""

from collections.abc import Sequence

from textual.content import Content

from capture_app.text import count, duration
from capture_app.tui.drawing.dots import DotCanvas

LABEL_WIDTH = 8
SHOWN_SHARE = 0.95
"""Of the exchanges, the shortest: a few long ones would make the rest a line at the left."""
MEASURABLE_NS = 1000
"""Round trips below this are of the clock's reading, not of a network."""
EDGE = "$foreground 30%"


def wedge_rows(samples_ns: Sequence[tuple[int, int]], width: int, height: int) -> list[Content]:
    """Draw offsets (less that of the shortest exchanges) over round trips, with the wedge they must lie in.

    An exchange whose round trip is r longer than the shortest can be wrong by r/2 at most to either side.
    """
    if len(samples_ns) < 2 or width <= LABEL_WIDTH + 4 or height < 3:
        return [Content.styled("No exchanges with the leader yet.", "$foreground-muted")]
    by_trip = sorted(samples_ns, key=lambda sample: sample[1])
    shown = by_trip[: max(2, round(SHOWN_SHARE * len(by_trip)))]
    shortest, longest = shown[0][1], max(shown[-1][1], shown[0][1] + 1)
    best = sorted(offset for offset, _ in by_trip[: max(1, len(by_trip) // 20)])
    middle = best[len(best) // 2]
    reach = max((longest - shortest) / 2, *(abs(offset - middle) for offset, _ in shown), 1.0)
    points, edges = DotCanvas(width - LABEL_WIDTH, height - 1), DotCanvas(width - LABEL_WIDTH, height - 1)
    across, down = points.dots

    def row_of(offset: float) -> int:
        return round((1 - offset / reach) / 2 * (down - 1))

    for x in range(across):
        half = (longest - shortest) * x / (across - 1) / 2
        edges.put(x, row_of(half))
        edges.put(x, row_of(-half))
    for offset, trip in shown:
        points.put(round((trip - shortest) / (longest - shortest) * (across - 1)), row_of(offset - middle))
    labels = {0: duration(reach, signed=True), (height - 1) // 2: "0", height - 2: f"−{duration(reach)}"}
    rows: list[Content] = []
    for y in range(height - 1):
        label = f"{labels.get(y, '')[: LABEL_WIDTH - 1]:>{LABEL_WIDTH - 1}} "
        rows.append(Content.styled(label, "$foreground-muted") + _over(points.row(y), edges.row(y)))
    left = duration(shortest) if shortest >= MEASURABLE_NS else "0"
    right = duration(longest)
    name = "round trip"
    gap = max(width - LABEL_WIDTH - len(left) - len(right) - len(name), 2)
    foot = " " * LABEL_WIDTH + left + " " * (gap // 2) + name + " " * (gap - gap // 2) + right
    return [*rows, Content.styled(foot, "$foreground-muted")]


def wedge_title(samples_ns: Sequence[tuple[int, int]]) -> str:
    """What the plot is of, in a few words."""
    if not samples_ns:
        return "clock"
    return f"clock offset, {count(len(samples_ns), 'exchange')}"


def _over(upper: str, lower: str) -> Content:
    """One row of dots where it has some, else the other."""
    parts: list[tuple[str, str]] = []
    for dot, edge in zip(upper, lower, strict=True):
        character, style = (dot, "$primary") if dot != " " else (edge, EDGE)
        if parts and parts[-1][1] == style:
            parts[-1] = (parts[-1][0] + character, style)
        else:
            parts.append((character, style))
    return Content.assemble(*parts)
