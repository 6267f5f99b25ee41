"""The line that a stream's frames lie on: time = height + period * index, fitted to many timestamps.

Each run of frames between two moves of the phase has a height of its own; all share the period, which belongs
to the camera's crystal.

A line fit that outliers hardly move.
"""

from collections import deque
from collections.abc import Iterable, Sequence
from itertools import pairwise
from math import isfinite, sqrt
from statistics import median

SIGMA_FROM_MAD = 1.4826
ROUNDS = 4
HUBER = 1.345
"""Residuals beyond this many sigma lose weight (Huber 1964; 95 % efficient for normal noise)."""


def fit_shared_slope(
    runs: Sequence[Sequence[tuple[float, float]]], start: float
) -> tuple[float, float, float]:
    """Huber fit of one slope through several runs of (x, y), each run with a height of its own.

    Returns the slope, its standard deviation and the standard deviation of the noise, in units of y (per
    x). `start` is a slope near enough that residuals about it tell the outliers. Runs of fewer than three
    points are passed over; with none left, the answer is (start, infinity, 0).
    """
    usable = [run for run in runs if len(run) >= 3]
    if not usable:
        return start, float("inf"), 0.0
    slope, noise, spread = start, 0.0, 0.0
    heights = [median([y - slope * x for x, y in run]) for run in usable]
    for _ in range(ROUNDS):
        misses = [
            [y - slope * x - height for x, y in run] for run, height in zip(usable, heights, strict=True)
        ]
        noise = SIGMA_FROM_MAD * median([abs(miss) for run in misses for miss in run])
        limit = HUBER * max(noise, 1.0)
        spread = product = 0.0
        means = []
        for run, run_misses in zip(usable, misses, strict=True):
            first_x = run[0][0]
            total = sum_x = sum_miss = sum_xx = sum_x_miss = 0.0
            for (x, _), miss in zip(run, run_misses, strict=True):
                weight = 1.0 if -limit <= miss <= limit else limit / abs(miss)
                along = x - first_x
                weighed = weight * along
                total += weight
                sum_x += weighed
                sum_miss += weight * miss
                sum_xx += weighed * along
                sum_x_miss += weighed * miss
            spread += sum_xx - sum_x * sum_x / total
            product += sum_x_miss - sum_x * sum_miss / total
            means.append((first_x + sum_x / total, sum_miss / total))
        if spread <= 0.0:
            return start, float("inf"), noise
        turn = product / spread
        slope += turn
        heights = [
            height + mean_miss - turn * mean_x
            for height, (mean_x, mean_miss) in zip(heights, means, strict=True)
        ]
    return slope, max(noise, 1.0) / sqrt(spread), noise


Point = tuple[int, int]
"""Index of a frame, and its time in ns since the stream's origin."""

WINDOW_FRAMES = 300
"""The newest frames, which the line is fitted to."""
REFIT_FRAMES = 10
REFIT_SHARE = 0.1
"""A period is fitted anew after so many frames, or so large a share of those that it was fitted to."""
PHASE_FRAMES = 10
MEDIAN_FACTOR = 1.25
"""A median of normal noise is this much noisier than a mean."""
QUANTIZED_FRAMES = 60
"""Frames that give the phase where timestamps come in steps: what one hides, another shows.

No more of them, as over many the error of a period that was learned from such steps looks like drift.
"""
QUANTUM_NOISE = 0.3
"""Standard deviation of a rounding error, as a share of the step."""
FINEST_PHASE = 1e-4
"""More frames than PHASE_FRAMES are used until the phase is known to this share of a period."""


class FrameLine:
    """Runs of points, the last one under way, with their common period; all times in ns."""

    def __init__(self, *, period_ns: float) -> None:
        self._nominal_ns = period_ns
        self.period_ns = period_ns
        self.period_sigma_ns = float("inf")
        """One standard deviation of the period; infinite before the first fit."""
        self.noise_ns = 0.0
        """Standard deviation of one timestamp."""
        self.height_ns = 0.0
        """Height of the run under way."""
        self.quantum_ns = 0.0
        """Step that the timestamps come in, 0 where it does not count."""
        self._hidden_ns: float | None = None
        self.runs: deque[list[Point]] = deque([[]])
        self._frames = self._since_fit = 0

    @property
    def known(self) -> bool:
        """Whether the period has been fitted."""
        return isfinite(self.period_sigma_ns)

    @property
    def run(self) -> list[Point]:
        """The run under way."""
        return self.runs[-1]

    @property
    def phase_frames(self) -> int:
        """How many of the newest frames give the height."""
        finest_ns = FINEST_PHASE * self.period_ns
        enough = round((MEDIAN_FACTOR * self.noise_ns / finest_ns) ** 2)
        if self.noise_ns < self.quantum_ns:
            return QUANTIZED_FRAMES
        return max(PHASE_FRAMES, min(WINDOW_FRAMES, enough))

    @property
    def tolerance_ns(self) -> float:
        """Largest distance of a frame from the line that noise explains."""
        return max(8.0 * self.noise_ns, 2_000.0)

    @property
    def quantum_error_ns(self) -> float:
        """What the step of the timestamps may hide of the height, either way.

        Whether a driver cuts or rounds cannot be told: between the two, a quarter of a step remains. Half
        of the widest gap between the places within a step that frames take is what their mean does not see.
        """
        if not self.quantum_ns:
            return 0.0
        if self._hidden_ns is not None:
            return self._hidden_ns
        heights = self.heights_of(self.run[-self.phase_frames :])
        places = sorted(height / self.quantum_ns % 1.0 for height in heights)
        widest = max([b - a for a, b in pairwise(places)] + [places[0] + 1.0 - places[-1]]) if places else 1.0
        self._hidden_ns = self.quantum_ns * (0.25 + widest / 2)
        return self._hidden_ns

    def heights_of(self, points: Iterable[Point]) -> list[float]:
        """The height of the line through each point, in ns, were its timestamp neither cut nor rounded."""
        return [time_ns - self.period_ns * index + self.quantum_ns / 4 for index, time_ns in points]

    def update_height(self) -> None:
        """Set the height of the line from the newest frames."""
        self._hidden_ns = None
        heights = self.heights_of(self.run[-self.phase_frames :])
        self.height_ns = median(heights)
        if self.quantum_ns:
            limit = self.quantum_ns
            offs = (min(max(height - self.height_ns, -limit), limit) for height in heights)
            self.height_ns += sum(offs) / len(heights)

    def begin_run(self, points: Sequence[Point] = ()) -> None:
        """Begin a run with these points, if there is anything in the one before."""
        if self.run:
            self.runs.append([])
        self.run.extend(points)
        self._frames += len(points)
        self._since_fit = 0
        self.height_ns = 0.0
        if points:
            self.update_height()

    def begin_at_rate(self, period_ns: float) -> None:
        """Forget all: the stream has another period from here on."""
        self.period_ns, self.period_sigma_ns = period_ns, float("inf")
        self.runs = deque([[(0, 0)]])
        self._frames, self._since_fit = 1, 0
        self.update_height()

    def add_point(self, point: Point, *, fit: bool) -> None:
        """Add a point to the run under way, and fit the period anew once enough points have come."""
        self.run.append(point)
        self._frames += 1
        self._since_fit += 1
        self._trim()
        if fit and (not self.known or self._since_fit >= max(REFIT_FRAMES, REFIT_SHARE * self._frames)):
            self._fit()
        self.update_height()

    def split_off(self, count: int) -> None:
        """Make the newest points a run of their own."""
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
        period_ns, spread_ns, self.noise_ns = fit_shared_slope(self.runs, self.period_ns)
        least_ns = QUANTUM_NOISE * self.quantum_ns
        if self.noise_ns < least_ns:
            spread_ns *= least_ns / max(self.noise_ns, 1.0)
            self.noise_ns = least_ns
        if spread_ns < 0.01 * self._nominal_ns:
            self.period_ns, self.period_sigma_ns = period_ns, spread_ns
