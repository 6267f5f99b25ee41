"""The drawings of a report as coordinates in px of their view box; a template makes SVG of them."""

from collections.abc import Sequence
from dataclasses import dataclass

from reconstruction.report import wording
from reconstruction.report.findings import Sides
from reconstruction.scores.comparison_results import OffsetTolerance
from reconstruction.scores.study_result import StudyResult


@dataclass(frozen=True)
class Axes:
    """A chart's view box and the margins around its drawing; upwards is a share, 0..1."""

    width: int
    height: int
    left: int
    right: int
    top: int
    bottom: int
    grid: Sequence[float]
    """Shares with a line across."""
    below: str
    """What the horizontal axis shows."""

    def y(self, share: float) -> float:
        """Where a share lies."""
        return round(self.height - self.bottom - (self.height - self.top - self.bottom) * share, 1)

    @property
    def middle(self) -> float:
        """The middle of the horizontal axis."""
        return (self.left + self.width - self.right) / 2


TOLERANCE_AXES = Axes(480, 300, 62, 14, 34, 48, (0, 0.25, 0.5, 0.75, 1), "delay of one camera, ms")
POSE_AXES = Axes(480, 220, 62, 10, 12, 48, (0, 0.5, 1), "camera pairs placed correctly, by instant")


def tolerance_chart(tolerance: OffsetTolerance) -> dict[str, object]:
    """The share of what moves that is found, against offset; what stands still beside it, as control.

    Of each kind (`mover`, `static`) the `curves` have its points: x, y, and y of the ends of the interval.
    The session's own synchronization error is the `mark`, x and words, if it lies on the drawing.
    """
    axes, points = TOLERANCE_AXES, tolerance.points
    offsets_ms = [point.late_ms or 0.0 for point in points]
    first, last = offsets_ms[0], offsets_ms[-1]
    scale = (axes.width - axes.left - axes.right - 26) / (last - first or 1.0)
    places = [round(axes.left + 10 + scale * (ms - first), 1) for ms in offsets_ms]
    curves = []
    for kind in ("static", "mover"):
        name = tolerance.measure.replace("mover", kind)
        drawn = [
            (x, axes.y(one.value), axes.y(one.ends[0]), axes.y(one.ends[1]))
            for x, point in zip(places, points, strict=True)
            if (one := point.interval(name, "offset")) is not None
        ]
        curves += [(kind, drawn)] if drawn else []
    what = "right within 2 %" if tolerance.measure.endswith("within_2pct") else "with a distance"
    words = "; ".join(
        f"{wording.milliseconds(round(ms, 1))}: "
        f"{wording.share(point.value(tolerance.measure, 'offset'), decimals=0)}"
        for ms, point in zip(offsets_ms, points, strict=True)
    )
    own_us, mark = tolerance.sync_residual_us, None
    if own_us is not None and own_us / 1000 <= last:
        place = round(axes.left + 10 + scale * (own_us / 1000 - first), 1)
        mark = place, wording.microseconds(own_us)
    return {
        "axes": axes,
        "label": f"Share of moving surface {what} by delay: {words}",
        "ticks": [(x, f"{ms:.0f}") for x, ms in zip(places, offsets_ms, strict=True)],
        "curves": curves,
        "mark": mark,
    }


def pose_chart(poses: StudyResult, sides: Sides) -> dict[str, object]:
    """Two bars for each instant: the share of camera pairs that were placed correctly; none of no instant.

    Of each of the `bars`: its condition, x, y and height.
    """
    axes = POSE_AXES
    step = (axes.width - axes.left - axes.right) / max(1, len(poses.per_instant))
    width = round(min(28.0, step * 0.36), 1)
    ticks, bars, told = [], [], []
    for place, row in enumerate(poses.per_instant):
        middle = axes.left + step * (place + 0.5)
        words = []
        for tone, name, left in (("synced", sides.first, -1.0), ("offset", sides.late, 0.0)):
            share = row.get(f"{tone}_correct_pairs") or 0.0
            # A share of 0 still gets a visible bar.
            top = min(axes.y(share), axes.y(0) - 2)
            bars.append((tone, round(middle + left * (width + 1), 1), top, round(axes.y(0) - top, 1)))
            words.append(f"{name.lower()} {wording.share(share, decimals=0)}")
        ticks.append((round(middle, 1), f"{row['instant']}"))
        told.append(f"instant {row['instant']}: {', '.join(words)}")
    label = f"Share of camera pairs placed correctly; {'; '.join(told)}"
    return {"axes": axes, "label": label, "ticks": ticks, "bars": bars, "bar_width": width}
