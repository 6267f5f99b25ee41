"""The gauge that shows how far a stream is from the grid."""

import math

GAUGE_FULL_SCALE_NS = 16_666_667
"""Half a period at 30 fps: the farthest that a stream can be from the grid."""
_GAUGE_LINEAR_NS = 10_000


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
