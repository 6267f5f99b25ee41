"""Numbers as people read them on a screen."""

import math

GAUGE_FULL_SCALE_NS = 16_666_667
"""Half a period at 30 fps: the farthest that a stream can be from the grid."""
_GAUGE_LINEAR_NS = 10_000


def short_time(ns: int | None, *, signed: bool = False) -> str:
    """Return a short time with its unit: 850 ns, 12 µs, 3.4 ms, 2.1 s; a dash for None."""
    if ns is None:
        return "–"
    sign = "-" if ns < 0 else ("+" if signed else "")
    size = abs(ns)
    if size < 1_000:
        return f"{sign}{size} ns"
    for unit, scale in (("µs", 1_000), ("ms", 1_000_000)):
        if size < scale * 999.5:
            digits = 1 if size < scale * 9.95 else 0
            return f"{sign}{size / scale:.{digits}f} {unit}"
    return f"{sign}{size / 1e9:.1f} s"


def clock_offset(ns: int | None) -> str:
    """Return the offset of a clock, from ns to days: +4 h 12 min, -12.3 s, +45 µs; a dash for None."""
    if ns is None:
        return "–"
    seconds = abs(ns) / 1e9
    if seconds < 60:
        return short_time(ns, signed=True)
    sign = "-" if ns < 0 else "+"
    minutes = round(seconds / 60)
    if minutes < 60:
        return f"{sign}{minutes} min"
    hours, minutes = divmod(minutes, 60)
    if hours < 48:
        return f"{sign}{hours} h {minutes:02d} min"
    return f"{sign}{hours // 24} d {hours % 24} h"


def gauge(error_ns: int | None, width: int) -> str:
    """Return a stream's distance from the grid as a mark on a line, the middle being in step.

    The scale is logarithmic on both sides from 10 µs up to half a period, so that a camera can be seen
    coming home from milliseconds to microseconds.
    """
    middle = width // 2
    line = ["·"] * width
    line[middle] = "│"
    if error_ns is not None:
        share = math.log1p(abs(error_ns) / _GAUGE_LINEAR_NS) / math.log1p(
            GAUGE_FULL_SCALE_NS / _GAUGE_LINEAR_NS
        )
        steps = round(min(share, 1.0) * ((width - 1) // 2))
        line[middle + int(math.copysign(steps, error_ns))] = "●"
    return "".join(line)
