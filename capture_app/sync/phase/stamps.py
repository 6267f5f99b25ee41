"""Frame stamps: the error of a stream, and the step that a driver's timestamps come in.

Timestamps of 1 ms, of a 90 kHz clock or of 10 us look like noise, or like none at all where the period is a
multiple of the step. Intervals that keep to a lattice give the step away, also where a conversion of clocks
has added some jitter to it.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from statistics import median


@dataclass(frozen=True, slots=True)
class FrameStamp:
    """The driver's number and timestamp of one frame; the time in ns of the node's local clock.

    `stream` counts the stream's starts: sequence numbers compare only within one stream.
    """

    sequence: int
    stream: int
    timestamp_ns: int


@dataclass(frozen=True, slots=True)
class StampError:
    """What is known of one timestamp's error; times in ns."""

    outlier_ns: int = 0
    """How far it lies off the line of its stream's frames; where not 0, the line tells the frame's time."""
    uncertainty_ns: float = 0.0
    """How far off that time may be, in 95 of 100 cases, for the stamps' noise and the step they come in."""
    hard_bound_ns: float = 0.0
    """How far at most, for that step."""


@dataclass(frozen=True, slots=True)
class PhaseEstimate:
    """The error of a stream against its grid at one instant of leader time."""

    error_ns: int
    """Signed distance of the nearest frame from the nearest grid instant, in [-period/2, period/2)."""
    period_ns: int
    """The camera's period, in leader time; the drift says it more finely."""
    drift_ppm: float
    """Change of the error, in us per second."""
    sigma_ns: float
    """One standard deviation of the error from the timestamps' noise; the clock's comes on top."""
    frames: int
    """Frames since the phase last moved."""
    at_leader_ns: int
    quantum_error_ns: float = 0.0
    """What the step that the timestamps come in may hide of the error, either way."""

    @property
    def uncertainty_ns(self) -> float:
        """How far off the error may be, in 95 of 100 cases; the clock's uncertainty comes on top."""
        return 2.0 * self.sigma_ns + self.quantum_error_ns


REMEMBERED = 90
LEAST_INTERVALS = 29
EVERY_FRAMES = 12
"""After how many frames the step is looked for anew."""
ON_LATTICE = 0.15
"""An interval this share of a step off the lattice, or less, is on it."""
JITTERS = 4.0
"""Nor is one on it that is so many times as far off as the usual ones are."""
SURE_SHARE = 0.9
"""Share of the intervals that must be on the lattice, of the usual ones as of the others."""
OTHER_INTERVALS = 8
"""Intervals on the lattice that must not be the usual one: a few late frames may make a lattice of their own.
The long and the short interval on either side of one late frame say the same, and count once."""
EXACT_NS = 2.0
"""Rounding of the ns."""
FINEST_NS = 200.0
"""Finer steps make no difference to any camera."""
WIDEST_GAPS = 8
STRETCHES = (1.0, 1.2, 1.5, 2.0)
"""Jitter narrows the gaps between the lattice's intervals: steps that are wider than a gap are tried, too."""
COARSEST = 0.25
"""The coarsest step that is looked for, as a share of a period."""
KNOWN_STEPS_NS = (1e6, 5e5, 2e5, 1e5, 5e4, 2e4, 1e9 / 90_000, 1e4, 5e3, 2e3, 1e3)
"""Steps of clocks that are looked for where the intervals hardly differ, the coarsest first."""

COARSE_NS, CLOCKS_APART = 1e5, 3e-4
"""Steps that fine are still told apart, where the stamping clock runs so differently."""


class StampQuantum:
    """Feed it the intervals of a stream's timestamps, in ns; `ns` is their step, 0 while none is known."""

    def __init__(self) -> None:
        self.ns = 0.0
        self._intervals: deque[int] = deque(maxlen=REMEMBERED)
        self._until_due = LEAST_INTERVALS

    def add(self, interval_ns: int) -> None:
        """Add the interval of two frames that follow each other."""
        self._intervals.append(interval_ns)
        self._until_due -= 1
        if self._until_due <= 0:
            self._until_due = EVERY_FRAMES
            found_ns = find_quantum(self._intervals)
            if found_ns or not self.ns or not _keep_to(self.ns, _deviations(self._intervals)):
                self.ns = found_ns


def find_quantum(intervals_ns: Sequence[int]) -> float:
    """The coarsest step in ns that the intervals of a stream keep to, 0 where there is none."""
    if len(intervals_ns) < LEAST_INTERVALS:
        return 0.0
    offs = _deviations(intervals_ns)
    if sum(abs(off) <= EXACT_NS for off in offs) > len(offs) / 2:
        # No clock runs so evenly that its finer timestamps are equally far apart time after time.
        # Those of 33,333,333 ns would be 3000 of a 90 kHz clock: if all are alike, only decimal steps count.
        alike = max(offs) - min(offs) <= EXACT_NS
        steps = (step for step in KNOWN_STEPS_NS if not alike or step % 1000 == 0)
        fitting = (step for step in steps if _are_multiples(intervals_ns, step))
        if alike:
            return _skewed_step(median(intervals_ns)) or next(fitting, 0.0)
        found_ns = next(fitting, 0.0)
        if found_ns:
            return found_ns
    gaps = sorted((b - a for a, b in pairwise(sorted(offs)) if b - a > EXACT_NS), reverse=True)
    tried = sorted((gap * stretch for gap in gaps[:WIDEST_GAPS] for stretch in STRETCHES), reverse=True)
    coarsest_ns = COARSEST * median(intervals_ns)
    for tried_ns in tried:
        counts = [round(off / tried_ns) for off in offs]
        others = [(off, count) for off, count in zip(offs, counts, strict=True) if count]
        returns = sum(a != 0 and a == -b for a, b in pairwise(counts))
        if len(others) - returns < OTHER_INTERVALS:
            continue
        step_ns = sum(off * count for off, count in others) / sum(count * count for _, count in others)
        if FINEST_NS < step_ns < coarsest_ns and _keep_to(step_ns, offs):
            return step_ns
    return 0.0


def _skewed_step(interval_ns: float) -> float:
    """The coarse step of which an interval is a multiple by another clock, in ns of this one; 0 for none."""
    for step_ns in KNOWN_STEPS_NS:
        count = round(interval_ns / step_ns)
        if step_ns >= COARSE_NS and abs(interval_ns / (count * step_ns) - 1.0) <= CLOCKS_APART:
            return interval_ns / count
    return 0.0


def _deviations(intervals_ns: Sequence[int]) -> list[int]:
    """How far each interval is off the usual one; those over dropped or long frames are left out."""
    usual_ns = sorted(intervals_ns)[len(intervals_ns) // 2]
    return [interval - usual_ns for interval in intervals_ns if abs(interval - usual_ns) < usual_ns / 2]


def _keep_to(step_ns: float, offs_ns: Sequence[int]) -> bool:
    """Whether nearly all deviations are multiples of a step, but for jitter, which the usual ones show."""
    away_ns = [(abs(off - step_ns * (count := round(off / step_ns))), count) for off in offs_ns]
    usual_ns = [away for away, count in away_ns if not count]
    jitter_ns = median(usual_ns) if usual_ns else 0.0
    near_ns = max(EXACT_NS, min(ON_LATTICE * step_ns, JITTERS * jitter_ns))
    others_ns = [away for away, count in away_ns if count]
    return all(
        sum(away <= near_ns for away in some_ns) >= SURE_SHARE * len(some_ns)
        for some_ns in (usual_ns, others_ns)
    )


def _are_multiples(intervals_ns: Sequence[int], step_ns: float) -> bool:
    """Whether all intervals are multiples of a step, but for the rounding of the ns."""
    return all(abs(ns - step_ns * round(ns / step_ns)) <= EXACT_NS for ns in intervals_ns)
