"""How the phase errors of the latest frames are spread."""

from collections.abc import Sequence

from textual.content import Content

from capture_app.text import duration

SHOWN_SHARE = 0.98
"""Of the frames; those farther off are counted at the ends."""
BARS = " ▁▂▃▄▅▆▇█"


def histogram_rows(errors_ns: Sequence[int], tolerance_ns: int, width: int, height: int) -> list[Content]:
    """Bars of how many frames were how far off; what is within the tolerance in another colour."""
    if not errors_ns or width < 12 or height < 3:
        return [Content.styled("No frame on the grid yet.", "$foreground-muted")]
    sizes = sorted(abs(error) for error in errors_ns)
    reach = max(1.25 * tolerance_ns, sizes[int(SHOWN_SHARE * (len(sizes) - 1))], 1.0)
    bins = [0] * width
    for error in errors_ns:
        bins[max(0, min(int((error / reach + 1) / 2 * width), width - 1))] += 1
    tallest = max(bins)
    rows: list[Content] = []
    for y in range(height - 1, 0, -1):
        parts: list[tuple[str, str]] = []
        for x, size in enumerate(bins):
            # Of a bar with anything in it, an eighth of a cell at least is seen.
            eighths = 0 if not size else max(round(8 * (height - 1) * size / tallest), 1)
            bar = BARS[min(max(eighths - 8 * (y - 1), 0), 8)]
            inside = abs((x + 0.5) / width * 2 - 1) * reach <= tolerance_ns
            parts.append((bar, "$success on $success 9%" if inside else "$warning"))
        rows.append(Content.assemble(*parts))
    left, right = f"−{duration(reach)}", duration(reach, signed=True)
    gap = max(width - len(left) - len(right) - 1, 2)
    axis = left + " " * (gap // 2) + "0" + " " * (gap - gap // 2) + right
    return [*rows, Content.styled(axis[:width], "$foreground-muted")]


def histogram_title(errors_ns: Sequence[int], tolerance_ns: int) -> str:
    """What the bars are of, in a few words."""
    if not errors_ns:
        return "phase error"
    inside = sum(abs(error) <= tolerance_ns for error in errors_ns)
    share = 100 * inside / len(errors_ns)
    return f"phase, {share:.0f} % of {len(errors_ns)} within ±{duration(tolerance_ns)}"
