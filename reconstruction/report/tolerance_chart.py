"""The tolerance curve as coordinates in px of its chart's view box; a template draws it as SVG."""

from reconstruction.common import wording
from reconstruction.method.comparison_results import OffsetTolerance
from reconstruction.pages.charts import Axes

TOLERANCE_AXES = Axes(480, 300, 62, 14, 34, 48, (0, 0.25, 0.5, 0.75, 1), "delay of one camera, ms")


def tolerance_chart(tolerance: OffsetTolerance) -> dict[str, object]:
    """Draw the fraction of moving pixels found against offset, with still pixels as control.

    Each of the `curves` (`mover`, `static`) has points: x, y, and y of the interval's ends. `mark` is the
    session's own synchronization error, as x and text, if it is inside the drawing.
    """
    axes, points = TOLERANCE_AXES, tolerance.points
    offsets_ms = [point.late_ms or 0.0 for point in points]
    first, last = offsets_ms[0], offsets_ms[-1]
    scale = (axes.width - axes.left - axes.right - 26) / (last - first or 1.0)
    places = [round(axes.left + 10 + scale * (ms - first), 1) for ms in offsets_ms]
    curves = []
    for kind in ("static", "mover"):
        drawn = [
            (x, axes.y(interval.value), axes.y(interval.ends[0]), axes.y(interval.ends[1]))
            for x, point in zip(places, points, strict=True)
            if (interval := point.interval(tolerance.measure.replace("mover", kind), "offset")) is not None
        ]
        curves += [(kind, drawn)] if drawn else []
    what = "right within 2 %" if tolerance.right else "with a distance"
    words = "; ".join(
        f"{wording.milliseconds(round(ms, 1))}: "
        f"{wording.percentage(point.value(tolerance.measure, 'offset'), decimals=0)}"
        for ms, point in zip(offsets_ms, points, strict=True)
    )
    own_us, mark = tolerance.sync_residual_us, None
    if own_us is not None and own_us / 1000 <= last:
        mark = round(axes.left + 10 + scale * (own_us / 1000 - first), 1), wording.microseconds(own_us)
    return {
        "axes": axes,
        "label": f"Fraction of moving surface {what} by delay: {words}",
        "ticks": [(x, f"{ms:.0f}") for x, ms in zip(places, offsets_ms, strict=True)],
        "curves": curves,
        "mark": mark,
    }
