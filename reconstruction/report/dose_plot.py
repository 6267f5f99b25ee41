"""The dose curve as a drawing (SVG) in the report's colours; words and lines, no pictures."""

from html import escape

from reconstruction.report import wording
from reconstruction.scores.dose_results import DoseResult
from reconstruction.scores.results import Interval

WIDE, HIGH = 480, 300
LEFT, RIGHT, TOP, BOTTOM = 62, 14, 34, 48


def dose_plot(dose: DoseResult) -> str:
    """The share of what moves that is found, against offset; what stands still beside it, as control."""
    still = dose.measure.replace("mover_", "static_")
    last = max(point.offset_ms for point in dose.points) or 1.0
    curves = []
    for name, tone in ((still, "var(--soft)"), (dose.measure, "var(--synced)")):
        known = []
        for point in dose.points:
            value: float | None = getattr(point.scores, name)
            if value is not None:
                at = point.scores.intervals.get(name) or Interval(value=value, low=value, high=value)
                known.append((point.offset_ms, at))
        curves.append(_curve(known, last, tone, control=name == still))
    what = "right within 2 %" if dose.measure.endswith("within_2pct") else "with a distance"
    grid = "".join(
        f'<path d="M{LEFT} {_y(share):.1f}H{WIDE - RIGHT}" stroke="var(--line)"/>'
        f'<text x="{LEFT - 8}" y="{_y(share) + 5:.1f}" text-anchor="end">{100 * share:.0f} %</text>'
        for share in (0, 0.25, 0.5, 0.75, 1)
    )
    ticks = "".join(
        f'<text x="{_x(point.offset_ms, last):.1f}" y="{HIGH - BOTTOM + 20}" text-anchor="middle">'
        f"{wording.milliseconds(round(point.offset_ms, 0)).removesuffix(wording.GAP + 'ms')}</text>"
        for point in dose.points
    )
    middle = (LEFT + WIDE - RIGHT) / 2
    words = "; ".join(
        f"{wording.milliseconds(round(point.offset_ms, 1))}: "
        f"{wording.share(getattr(point.scores, dose.measure), decimals=0)}"
        for point in dose.points
    )
    return f"""<svg class="dose" viewBox="0 0 {WIDE} {HIGH}" role="img"
 aria-label="{escape(f"Share of moving surface {what} by lateness: {words}")}">
{grid}{ticks}
<text x="{middle}" y="{HIGH - 6}" text-anchor="middle">one camera late by, ms</text>
{"".join(curves)}{_mark(dose, last)}
</svg>"""


def _curve(known: list[tuple[float, Interval]], last: float, tone: str, *, control: bool) -> str:
    if not known:
        return ""
    ends = [(_x(ms, last), one) for ms, one in known]
    band = [f"{x:.1f},{_y(one.high):.1f}" for x, one in ends]
    band += [f"{x:.1f},{_y(one.low):.1f}" for x, one in reversed(ends)]
    line = " ".join(f"{x:.1f},{_y(one.value):.1f}" for x, one in ends)
    dash = ' stroke-dasharray="5 4"' if control else ""
    dots = "".join(f'<circle cx="{x:.1f}" cy="{_y(one.value):.1f}" r="3.5"/>' for x, one in ends)
    return (
        f'<g fill="{tone}"><polygon points="{" ".join(band)}" opacity=".18"/>'
        f'<polyline points="{line}" fill="none" stroke="{tone}" stroke-width="2.5"{dash}/>{dots}</g>'
    )


def _mark(dose: DoseResult, last: float) -> str:
    """The session's own error, where it has one that lies on the drawing."""
    if dose.own_error_us is None or dose.own_error_us / 1000 > last:
        return ""
    x = _x(dose.own_error_us / 1000, last)
    side = "end" if x > WIDE / 2 else "start"
    return (
        f'<path d="M{x:.1f} {TOP - 8}V{HIGH - BOTTOM}" stroke="var(--offset)" stroke-width="2"/>'
        f'<text x="{x:.1f}" y="{TOP - 14}" text-anchor="{side}" class="mark">'
        f"this session: {escape(wording.microseconds(dose.own_error_us))}</text>"
    )


def _x(offset_ms: float, last: float) -> float:
    return LEFT + 10 + (WIDE - LEFT - RIGHT - 26) * offset_ms / last


def _y(share: float) -> float:
    return HIGH - BOTTOM - (HIGH - TOP - BOTTOM) * share
