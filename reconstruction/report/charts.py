"""The drawings of a report as coordinates in px of their view box; the templates make SVG of them."""

from collections.abc import Sequence
from dataclasses import dataclass

from reconstruction.report import wording
from reconstruction.scores.comparison_results import DoseResult
from reconstruction.scores.study_result import PoseComparison


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


DOSE_AXES = Axes(480, 300, 62, 14, 34, 48, (0, 0.25, 0.5, 0.75, 1), "delay of one camera, ms")
POSE_AXES = Axes(480, 220, 62, 10, 12, 48, (0, 0.5, 1), "camera pairs placed correctly, by instant")


@dataclass(frozen=True)
class CurvePoint:
    """A value and the ends of its interval."""

    x: float
    y: float
    low: float
    high: float


@dataclass(frozen=True)
class Curve:
    """A line with its band of intervals; the control is dashed."""

    points: Sequence[CurvePoint]
    control: bool


@dataclass(frozen=True)
class DoseChart:
    """Shares found against offset; `mark` is the session's synchronization error, if it is on the drawing."""

    label: str
    ticks: Sequence[tuple[float, str]]
    curves: Sequence[Curve]
    mark: tuple[float, str] | None
    axes: Axes = DOSE_AXES


def dose_chart(dose: DoseResult) -> DoseChart:
    """The share of what moves that is found, against offset; what stands still beside it, as control."""
    first, last = dose.points[0].offset_ms, dose.points[-1].offset_ms
    reach = last - first or 1.0

    def x(offset_ms: float) -> float:
        axes = DOSE_AXES
        return round(
            axes.left + 10 + (axes.width - axes.left - axes.right - 26) * (offset_ms - first) / reach, 1
        )

    curves = []
    for control, name in ((True, dose.measure.replace("mover_", "static_")), (False, dose.measure)):
        points = []
        for point in dose.points:
            if (one := point.scores.interval_of(name)) is not None:
                points.append(
                    CurvePoint(x(point.offset_ms), *map(DOSE_AXES.y, (one.value, one.low, one.high)))
                )
        curves.append(Curve(points, control))
    what = "right within 2 %" if dose.measure.endswith("within_2pct") else "with a distance"
    words = "; ".join(
        f"{wording.milliseconds(round(point.offset_ms, 1))}: "
        f"{wording.share(getattr(point.scores, dose.measure), decimals=0)}"
        for point in dose.points
    )
    own_us = dose.sync_residual_us
    return DoseChart(
        label=f"Share of moving surface {what} by delay: {words}",
        ticks=[(x(point.offset_ms), f"{point.offset_ms:.0f}") for point in dose.points],
        curves=[curve for curve in curves if curve.points],
        mark=None
        if own_us is None or own_us / 1000 > last
        else (x(own_us / 1000), wording.microseconds(own_us)),
    )


@dataclass(frozen=True)
class Bar:
    """A bar of one condition: its left edge, its top and its height."""

    tone: str
    x: float
    y: float
    height: float


@dataclass(frozen=True)
class PoseChart:
    """Two bars for each instant: the share of camera pairs that were placed correctly."""

    label: str
    ticks: Sequence[tuple[float, str]]
    bars: Sequence[Bar]
    width: float
    """Of a bar."""
    axes: Axes = POSE_AXES


def pose_chart(result: PoseComparison, sides: wording.Sides) -> PoseChart:
    """The chart of the camera pairs that were placed correctly; no bars where there is no instant."""
    axes = POSE_AXES
    step = (axes.width - axes.left - axes.right) / max(1, len(result.per_instant))
    width = round(min(28.0, step * 0.36), 1)
    ticks, bars, told = [], [], []
    for place, row in enumerate(result.per_instant):
        middle = axes.left + step * (place + 0.5)
        words = []
        for tone, name, left in (("synced", sides.first, -1.0), ("offset", sides.late, 0.0)):
            share = float(row.get(f"{tone}_correct_pairs") or 0.0)
            # A share of 0 still gets a visible bar.
            top = min(axes.y(share), axes.y(0) - 2)
            bars.append(Bar(tone, round(middle + left * (width + 1), 1), top, round(axes.y(0) - top, 1)))
            words.append(f"{name.lower()} {wording.share(share, decimals=0)}")
        ticks.append((round(middle, 1), f"{row['instant']}"))
        told.append(f"instant {row['instant']}: {', '.join(words)}")
    return PoseChart(f"Share of camera pairs placed correctly; {'; '.join(told)}", ticks, bars, width)
