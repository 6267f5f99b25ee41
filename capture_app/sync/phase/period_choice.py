"""Choice of a rig's frame period: the most common period of its machines, one vote per machine.

A machine's vote is the most common period of its own cameras. A host with many cameras, or a faulty one,
therefore does not decide for the others. Periods that one rig can hold count as equal; a video period is
preferred to a stills period.
"""

from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Sequence

MAX_DRIFT_PPM = 1000.0
"""Maximum drift of a camera against the grid at which its frames can still be held on it."""
MAX_VIDEO_PERIOD_NS = 1_000_000_000
"""A camera with a longer period takes stills, and decides only if there is no other camera."""


def choose_period(present_ns: int, machines: Iterable[Sequence[int]]) -> int:
    """Return a rig's period in ns from the camera periods of each machine; in a tie, the present one."""
    return _max_common(present_ns, [_max_common(present_ns, periods_ns) for periods_ns in machines])


def can_hold(period_ns: int, grid_period_ns: int) -> bool:
    """Whether a camera of one period can be held on a grid of another."""
    return abs(period_ns - grid_period_ns) <= _tolerance_ns(grid_period_ns)


def _max_common(present_ns: int, periods_ns: Sequence[int]) -> int:
    ordered = sorted(periods_ns)

    def support(period_ns: int) -> tuple[bool, int]:
        tolerance_ns = _tolerance_ns(period_ns)
        first, end = (
            bisect_left(ordered, period_ns - tolerance_ns),
            bisect_right(ordered, period_ns + tolerance_ns),
        )
        return end > first and period_ns <= MAX_VIDEO_PERIOD_NS, end - first

    best_ns = max(dict.fromkeys(periods_ns), key=support)
    return best_ns if support(best_ns) > support(present_ns) else present_ns


def _tolerance_ns(period_ns: int) -> float:
    return period_ns * MAX_DRIFT_PPM * 1e-6
