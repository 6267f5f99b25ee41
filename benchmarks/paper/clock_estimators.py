"""Clock estimators with one interface and one result, from the paper's filters to ours.

`ClockFilter` is the engine's estimator; the others are baselines.
"""

from collections import deque
from collections.abc import Callable, Sequence
from itertools import pairwise

from capture_app.sync.clock.clock_filter import ClockFilter, ClockSample
from capture_app.sync.clock.likely_line import MAX_SKEW, lower_hull
from capture_app.sync.clock.time_map import ROUNDING_NS, TimeMap

REJECT_NS = 10_000_000
"""Round trip above which the paper's mean filter drops a sample (section 4)."""

Line = tuple[float, float, int]
"""Offset in ns at a local time in ns, skew (dimensionless), and that local time."""


class WindowFilter:
    """Estimator that fits a line to a window's samples by a rule; its hard bound holds for any line.

    The rules do not estimate their error: the stated uncertainty is the hard bound.
    """

    def __init__(self, rule: Callable[[Sequence[ClockSample], int], Line], *, window_ns: int) -> None:
        self._rule = rule
        self._window_ns = window_ns
        self._kept: deque[ClockSample] = deque()
        self.samples = 0

    def add(self, sample: ClockSample) -> bool:
        """Add a sample; steps are not detected."""
        if sample.round_trip_ns < 0 or sample.t2_ns < sample.t1_ns or sample.t3_ns < sample.t0_ns:
            return True
        self.samples += 1
        self._kept.append(sample)
        while self._kept[0].t3_ns < sample.t3_ns - self._window_ns:
            self._kept.popleft()
        return True

    def time_map(self, now_local_ns: int) -> TimeMap | None:
        """Return the time map with its epoch at a local time in ns; None before the first sample."""
        if not self._kept:
            return None
        anchor_ns = (self._kept[0].upper_ns + self._kept[0].lower_ns) // 2
        offset, skew, at_ns = self._rule(self._kept, anchor_ns)
        offset_ns = anchor_ns + round(offset + skew * (now_local_ns - at_ns))
        highest = min(s.upper_ns + MAX_SKEW * abs(now_local_ns - s.t0_ns) for s in self._kept)
        lowest = max(s.lower_ns - MAX_SKEW * abs(now_local_ns - s.t3_ns) for s in self._kept)
        bound = max(highest - offset_ns, offset_ns - lowest) + ROUNDING_NS
        return TimeMap(
            epoch_local_ns=now_local_ns,
            offset_ns=offset_ns,
            skew=skew,
            uncertainty_ns=bound,
            hard_bound_ns=bound,
            skew_uncertainty=MAX_SKEW + abs(skew),
            skew_bound=MAX_SKEW + abs(skew),
            samples=self.samples,
            round_trip_ns=min(s.round_trip_ns for s in self._kept),
        )


ClockEstimator = ClockFilter | WindowFilter


def mean(samples: Sequence[ClockSample], anchor_ns: int) -> Line:
    """Return the mean of all offsets with round trips up to 10 ms; of all offsets if there are no others."""
    short = [s for s in samples if s.round_trip_ns <= REJECT_NS] or samples
    offset = sum(s.upper_ns + s.lower_ns - 2 * anchor_ns for s in short) / (2.0 * len(short))
    return offset, 0.0, samples[-1].t3_ns


def minimum(samples: Sequence[ClockSample], anchor_ns: int) -> Line:
    """Return the offset of the sample with the minimum round trip, as in the paper and libsoftwaresync."""
    best = min(samples, key=lambda s: s.round_trip_ns)
    return (best.upper_ns + best.lower_ns - 2 * anchor_ns) / 2.0, 0.0, (best.t0_ns + best.t3_ns) // 2


def per_direction_minimum(samples: Sequence[ClockSample], anchor_ns: int) -> Line:
    """Return the middle of the tightest bounds of the two directions, each taken separately."""
    upper = min(s.upper_ns for s in samples) - anchor_ns
    lower = max(s.lower_ns for s in samples) - anchor_ns
    return (upper + lower) / 2.0, 0.0, samples[-1].t3_ns


def widest_line(samples: Sequence[ClockSample], anchor_ns: int) -> Line:
    """Return the line with the largest margin between both directions (Moon et al. 1999, linear program)."""
    at_ns = samples[-1].t3_ns
    above = lower_hull((float(s.t0_ns - at_ns), float(s.upper_ns - anchor_ns)) for s in samples)
    below = lower_hull((float(s.t3_ns - at_ns), float(anchor_ns - s.lower_ns)) for s in samples)

    def edges(skew: float) -> tuple[float, float]:
        return min(v - skew * t for t, v in above), min(v + skew * t for t, v in below)

    # The margin is concave in the skew, and linear between the slopes of the two hulls.
    turns = [(v2 - v1) / (t2 - t1) for (t1, v1), (t2, v2) in pairwise(above)]
    turns += [(v1 - v2) / (t2 - t1) for (t1, v1), (t2, v2) in pairwise(below)]
    turns = [turn for turn in turns if abs(turn) < MAX_SKEW]
    skew = max([*turns, -MAX_SKEW, MAX_SKEW], key=lambda turn: sum(edges(turn)))
    high, low = edges(skew)
    return (high - low) / 2.0, skew, at_ns


def estimator_family(window_ns: int = 30_000_000_000) -> dict[str, ClockEstimator]:
    """Return one of each estimator by name, over a window in ns; `ours` is the engine's."""
    rules = {
        "mean": mean,
        "minimum": minimum,
        "per_direction_minimum": per_direction_minimum,
        "widest_line": widest_line,
    }
    family: dict[str, ClockEstimator] = {
        name: WindowFilter(rule, window_ns=window_ns) for name, rule in rules.items()
    }
    family["ours"] = ClockFilter(window_ns=window_ns)
    return family
