"""Robust fit of the line of a stream's frames: time = intercept + period * index.

Each run of frames between two phase moves has its own intercept. All runs share the period, which belongs to
the camera's crystal. Timestamps in steps (1 ms, a 90 kHz clock, 10 us) look like noise, or like no noise if
the period is a multiple of the step. Intervals on a lattice reveal the step, even after a clock conversion
that added jitter.
"""

from collections import deque
from collections.abc import Iterable, Sequence
from itertools import pairwise
from math import inf, isfinite, sqrt
from operator import mul
from statistics import median

SIGMA_FROM_MAD = 1.4826
"""Standard deviation of normal noise, relative to its median absolute deviation."""
ROUNDS = 4
"""Rounds of reweighting (chosen)."""
HUBER = 1.345
"""Residuals beyond this many sigma lose weight (Huber 1964; 95 % efficient for normal noise)."""
REMEMBERED, MIN_INTERVALS = 90, 29
"""Newest intervals that are searched for a step, 3 s at 30 fps, and the minimum for it: the first second."""
EVERY_FRAMES = 12
"""Minimum number of frames between searches for the step."""
ON_LATTICE = 0.15
"""Maximum distance from the lattice of an interval on it, as a fraction of a step."""
JITTERS = 4.0
"""Maximum distance from the lattice as a multiple of the jitter of the most common interval."""
SURE_FRACTION = 0.9
"""Fraction of intervals that must be on the lattice: of the most common interval, and of the others."""
OTHER_INTERVALS = 8
"""Minimum number of lattice intervals besides the most common one: a few late frames may form a lattice.

Neighbours as far from the most common one are redundant, and count once.
"""
EXACT_NS = 2.0
"""Tolerance for timestamps rounded to whole ns."""
FINEST_NS = 200.0
"""Minimum step of interest; finer steps make no difference to any camera."""
WIDEST_GAPS = 8
"""Gaps between intervals that may show the step: it is among the widest, and each costs a search."""
STRETCHES = (1.0, 1.2, 1.5, 2.0)
"""Factors on the gaps between lattice intervals, as jitter narrows these gaps."""
COARSEST = 0.25
"""Maximum step that is searched for, as a fraction of a period."""
KNOWN_STEPS_NS = (1e6, 5e5, 2e5, 1e5, 5e4, 2e4, 1e9 / 90_000, 1e4, 5e3, 2e3, 1e3)
"""Clock steps that are searched for if the intervals hardly differ, coarsest first."""
DEGRADED_NS, CLOCKS_APART = 1e5, 3e-4
"""Minimum step that is recognized although the stamping clock's rate is off, and the maximum rate error."""
WINDOW_FRAMES = 300
"""Number of newest frames to which the line is fitted."""
REFIT_FRAMES, REFIT_FRACTION = 10, 0.1
"""The period is refitted after REFIT_FRAMES, or after this fraction of the fitted frames if that is more."""
PHASE_FRAMES = 10
"""Frames whose median gives the phase: its standard deviation is then 0.4 of a frame's noise."""
MEDIAN_FACTOR = 1.25
"""Standard deviation of a median of normal noise, relative to a mean's."""
QUANTIZED_FRAMES = 60
"""Frames that determine the phase if timestamps come in steps, as different frames hide different errors.

Over more frames, the error of a period fitted to such timestamps would look like drift.
"""
QUANTUM_NOISE = 0.3
"""Standard deviation of a rounding error, as a fraction of the step."""
FINEST_PHASE = 1e-4
"""More frames than PHASE_FRAMES are used until the phase is known to this fraction of a period."""


def fit_shared_slope(
    runs: Sequence[Sequence[tuple[float, float]]], start: float
) -> tuple[float, float, float]:
    """Fit one slope through several runs of (x, y) with Huber weights; each run has its own intercept.

    Returns the slope, its standard deviation and the standard deviation of the noise, in units of y (per x).
    `start` must be close enough to the slope that residuals about it reveal the outliers. Runs of fewer than
    three points are skipped; if none is left, the result is (start, infinity, 0).
    """
    if not (usable := [run for run in runs if len(run) >= 3]):
        return start, float("inf"), 0.0
    slope, noise, time_variance = start, 0.0, 0.0
    intercepts = [median([y - slope * x for x, y in run]) for run in usable]
    for _ in range(ROUNDS):
        residuals = [
            [y - slope * x - intercept for x, y in run]
            for run, intercept in zip(usable, intercepts, strict=True)
        ]
        noise = SIGMA_FROM_MAD * median([abs(residual) for run in residuals for residual in run])
        limit = HUBER * max(noise, 1.0)
        time_variance = product = 0.0
        means = []
        for run, run_misses in zip(usable, residuals, strict=True):
            first_x = run[0][0]
            total = sum_x = sum_miss = sum_xx = sum_x_miss = 0.0
            for (x, _), residual in zip(run, run_misses, strict=True):
                weight = 1.0 if -limit <= residual <= limit else limit / abs(residual)
                along = x - first_x
                weighed = weight * along
                total += weight
                sum_x += weighed
                sum_miss += weight * residual
                sum_xx += weighed * along
                sum_x_miss += weighed * residual
            time_variance += sum_xx - sum_x * sum_x / total
            product += sum_x_miss - sum_x * sum_miss / total
            means.append((first_x + sum_x / total, sum_miss / total))
        if time_variance <= 0.0:
            return start, float("inf"), noise
        correction = product / time_variance
        slope += correction
        intercepts = [
            intercept + mean_miss - correction * mean_x
            for intercept, (mean_x, mean_miss) in zip(intercepts, means, strict=True)
        ]
    return slope, max(noise, 1.0) / sqrt(time_variance), noise


class StampQuantum:
    """Step of a stream's timestamps, found from their intervals; `ns` is 0 while none is known."""

    def __init__(self) -> None:
        self.ns = 0.0
        self._intervals: deque[int] = deque(maxlen=REMEMBERED)
        self._until_due, self._every = MIN_INTERVALS, EVERY_FRAMES

    def add(self, interval_ns: int) -> None:
        """Add an interval in ns between successive frames; search for the step again after some frames."""
        self._intervals.append(interval_ns)
        self._until_due -= 1
        if self._until_due <= 0:
            # What was found twice is looked for less often, though in all intervals.
            self._until_due, self._every = self._every, min(2 * self._every, REMEMBERED)
            found_ns = find_quantum(self._intervals)
            if found_ns or not self.ns or not _keep_to(self.ns, _deviations(self._intervals)):
                self._every = self._every if bool(found_ns) is bool(self.ns) else EVERY_FRAMES
                self.ns = found_ns


def find_quantum(intervals_ns: Sequence[int]) -> float:
    """Return the coarsest step in ns of which the intervals are multiples; 0 if there is none."""
    if len(intervals_ns) < MIN_INTERVALS:
        return 0.0
    offs = _deviations(intervals_ns)
    if sum(abs(off) <= EXACT_NS for off in offs) > len(offs) / 2:
        # No clock with finer timestamps runs so evenly that they stay equally far apart.
        # 33,333,333 ns is also 3000 ticks of a 90 kHz clock: if all intervals are equal, only decimal
        # steps count.
        equal = max(offs) - min(offs) <= EXACT_NS
        steps = (step for step in KNOWN_STEPS_NS if not equal or step % 1000 == 0)
        fitting = (
            step
            for step in steps
            if all(abs(ns - step * round(ns / step)) <= EXACT_NS for ns in intervals_ns)
        )
        if equal:
            return _skewed_step(median(intervals_ns)) or next(fitting, 0.0)
        if found_ns := next(fitting, 0.0):
            return found_ns
    gaps = sorted((b - a for a, b in pairwise(sorted(offs)) if b - a > EXACT_NS), reverse=True)
    tried = sorted((gap * stretch for gap in gaps[:WIDEST_GAPS] for stretch in STRETCHES), reverse=True)
    coarsest_ns = COARSEST * median(intervals_ns)
    for tried_ns in tried:
        counts = [round(off / tried_ns) for off in offs]
        squares = sum(map(mul, counts, counts))
        if not squares:
            continue
        step_ns: float = sum(map(mul, offs, counts)) / squares
        if (
            FINEST_NS < step_ns < coarsest_ns
            and _keep_to(step_ns, offs)
            and _others(counts) >= OTHER_INTERVALS
        ):
            return step_ns
    return 0.0


def scatter_of_neighbours(runs: Sequence[Sequence[tuple[float, float]]], slope: float) -> float:
    """Return the standard deviation of the noise of y from neighbouring points (x, y) about a slope.

    It is blind to what moves many points in a row. Without two points in a run it is infinity.
    """
    off = [abs(y2 - y1 - slope * (x2 - x1)) for run in runs for (x1, y1), (x2, y2) in pairwise(run)]
    return SIGMA_FROM_MAD * median(off) / sqrt(2.0) if off else inf


def _others(counts: Sequence[int]) -> int:
    """Return the number of other intervals than the most common one; equal neighbours count once.

    These are the two intervals of a late frame, or those of a camera that ran at another rate for a while.
    Rounding a steady stream's timestamps isolates its rarer interval.
    """
    again = sum(a != 0 and abs(a) == abs(b) for a, b in pairwise(counts))
    return len(counts) - counts.count(0) - again


def _skewed_step(interval_ns: float) -> float:
    """Return the timestamp step, in ns, if an interval is a multiple of a coarse step; 0 otherwise.

    The timestamps may come from a clock of a slightly different rate.
    """
    counts = ((step, round(interval_ns / step)) for step in KNOWN_STEPS_NS if step >= DEGRADED_NS)
    steps_ns = (
        interval_ns / count
        for step, count in counts
        if count and abs(interval_ns / (count * step) - 1.0) <= CLOCKS_APART
    )
    return next(steps_ns, 0.0)


def _deviations(intervals_ns: Sequence[int]) -> list[int]:
    """Return each interval's deviation from the median, without intervals over dropped or long frames."""
    median_ns = sorted(intervals_ns)[len(intervals_ns) // 2]
    return [interval - median_ns for interval in intervals_ns if abs(interval - median_ns) < median_ns / 2]


def _keep_to(step_ns: float, offs_ns: Sequence[int]) -> bool:
    """Whether nearly all `offs_ns` (deviations of intervals) are multiples of a step, but for jitter."""
    # Most steps that are tried fit nothing, which the first intervals show.
    far_ns = max(EXACT_NS, ON_LATTICE * step_ns)
    left = 1 + int((1.0 - SURE_FRACTION) * len(offs_ns))
    for off in offs_ns:
        if abs(off - step_ns * round(off / step_ns)) > far_ns:
            left -= 1
            if left < 0:
                return False
    distances_ns = [(abs(off - step_ns * (count := round(off / step_ns))), count) for off in offs_ns]
    zero_ns = [distance_ns for distance_ns, count in distances_ns if not count]
    jitter_ns = median(zero_ns) if zero_ns else 0.0
    near_ns = max(EXACT_NS, min(ON_LATTICE * step_ns, JITTERS * jitter_ns))
    others_ns = [distance_ns for distance_ns, count in distances_ns if count]
    return all(
        sum(distance_ns <= near_ns for distance_ns in some_ns) >= SURE_FRACTION * len(some_ns)
        for some_ns in (zero_ns, others_ns)
    )


Point = tuple[int, int]
"""Index of a frame, and its time in ns since the stream's origin."""


class FrameLine:
    """Line through runs of frames with a common period; the last run is the current one; times in ns."""

    def __init__(self, *, period_ns: float) -> None:
        self._nominal_ns = period_ns
        self.period_ns = period_ns
        self.period_sigma_ns = float("inf")
        """One standard deviation of the period; infinite before the first fit."""
        self.noise_ns = 0.0
        """Standard deviation of one timestamp about the line."""
        self._scatter_ns = 0.0
        """Standard deviation of one timestamp about its neighbours, which leave the line together."""
        self.intercept_ns = 0.0
        """Intercept of the current run."""
        self.quantum_ns = 0.0
        """Step of the timestamps; 0 if it is negligible."""
        self._hidden_ns: float | None = None
        self.runs: deque[list[Point]] = deque([[]])
        self._frames = self._since_fit = 0

    @property
    def known(self) -> bool:
        """Whether the period has been fitted."""
        return isfinite(self.period_sigma_ns)

    @property
    def run(self) -> list[Point]:
        """Points of the current run."""
        return self.runs[-1]

    @property
    def phase_frames(self) -> int:
        """Number of newest frames that determine the intercept."""
        if self.noise_ns < self.quantum_ns:
            return QUANTIZED_FRAMES
        # More frames average noise, but only delay what the phase has done.
        noise_ns = min(self.noise_ns, self._scatter_ns)
        enough = round((MEDIAN_FACTOR * noise_ns / (FINEST_PHASE * self.period_ns)) ** 2)
        return max(PHASE_FRAMES, min(WINDOW_FRAMES, enough))

    @property
    def tolerance_ns(self) -> float:
        """Maximum distance of a frame from the line that noise explains."""
        return max(8.0 * self.noise_ns, 2_000.0)

    @property
    def quantum_error_ns(self) -> float:
        """Error of the intercept that the step of the timestamps may hide, in either direction.

        Whether a driver truncates or rounds is unknown: halfway between, a quarter of a step remains. The
        mean is also blind to half of the widest gap between the positions of frames within a step.
        """
        if not self.quantum_ns:
            return 0.0
        if self._hidden_ns is not None:
            return self._hidden_ns
        intercepts = self.intercepts_of(self.run[-self.phase_frames :])
        places = sorted(intercept / self.quantum_ns % 1.0 for intercept in intercepts)
        widest = max([b - a for a, b in pairwise(places)] + [places[0] + 1.0 - places[-1]]) if places else 1.0
        self._hidden_ns = self.quantum_ns * (0.25 + widest / 2)
        return self._hidden_ns

    def intercepts_of(self, points: Iterable[Point]) -> list[float]:
        """Return each point's intercept in ns, corrected for the mean effect of truncation and rounding."""
        return [time_ns - self.period_ns * index + self.quantum_ns / 4 for index, time_ns in points]

    def update_height(self) -> None:
        """Set the intercept of the line from the newest frames."""
        self._hidden_ns = None
        intercepts = self.intercepts_of(self.run[-self.phase_frames :])
        self.intercept_ns = median(intercepts)
        if self.quantum_ns:
            limit = self.quantum_ns
            offs = (min(max(intercept - self.intercept_ns, -limit), limit) for intercept in intercepts)
            self.intercept_ns += sum(offs) / len(intercepts)

    def begin_run(self, points: Sequence[Point] = ()) -> None:
        """Start a run with these points; an empty current run is reused."""
        if self.run:
            self.runs.append([])
        self.run.extend(points)
        self._frames += len(points)
        self._since_fit = 0
        self.intercept_ns = 0.0
        if points:
            self.update_height()

    def begin_at_rate(self, period_ns: float) -> None:
        """Restart at a stream's new period."""
        self.period_ns, self.period_sigma_ns = period_ns, float("inf")
        self.runs = deque([[(0, 0)]])
        self._frames, self._since_fit = 1, 0
        self.update_height()

    def add_point(self, point: Point, *, fit: bool) -> None:
        """Add a point to the current run, and refit the period once enough points have arrived."""
        self.run.append(point)
        self._frames += 1
        self._since_fit += 1
        self._trim()
        if fit and (not self.known or self._since_fit >= max(REFIT_FRAMES, REFIT_FRACTION * self._frames)):
            self._fit()
        # The median of many frames hardly changes by one.
        elif not len(self.run) % max(1, min(len(self.run), self.phase_frames) // PHASE_FRAMES):
            self.update_height()

    def split_off(self, count: int) -> None:
        """Move the newest points to a run of their own."""
        points = self.run[-count:]
        del self.run[-count:]
        self.runs.append(points)
        self.update_height()

    def _trim(self) -> None:
        while self._frames > WINDOW_FRAMES:
            oldest = self.runs[0]
            drop = min(len(oldest), max(1, len(oldest) // 8))
            del oldest[:drop]
            self._frames -= drop
            if not oldest and len(self.runs) > 1:
                self.runs.popleft()

    def _fit(self) -> None:
        self._since_fit = 0
        period_ns, period_sigma_ns, self.noise_ns = fit_shared_slope(self.runs, self.period_ns)
        self._scatter_ns = scatter_of_neighbours(self.runs, period_ns)
        min_ns = QUANTUM_NOISE * self.quantum_ns
        if self.noise_ns < min_ns:
            period_sigma_ns *= min_ns / max(self.noise_ns, 1.0)
            self.noise_ns = min_ns
        if period_sigma_ns < 0.01 * self._nominal_ns:
            self.period_ns, self.period_sigma_ns = period_ns, period_sigma_ns
        # The intercept lies where the stream began: another period moves it by all that came since.
        self.update_height()
