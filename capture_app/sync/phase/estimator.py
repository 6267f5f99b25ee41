"""Period and phase of a stream from its frame timestamps, with dropped frames and commanded phase moves.

Frames are indexed along one line, time = intercept + period * index. A restart or an injected frame starts a
new run with another intercept. The period stays, as it belongs to the camera's crystal.
"""

from bisect import bisect_left, bisect_right
from collections import deque
from dataclasses import dataclass
from math import sqrt
from statistics import median

from capture_app.sync.phase.frame_line import MEDIAN_FACTOR, PHASE_FRAMES, FrameLine, Point, StampQuantum

LATENCY_FRAMES = (2, 13)
"""Minimum and maximum number of frames from a command to its effect."""
TYPICAL_LATENCY_FRAMES, REMEMBERED_LATENCIES = 4, 15
"""Latency assumed before any was observed, and number of observed latencies whose median replaces it."""
REMEMBERED_FRAMES = 20_000
"""Frames whose effective shift is stored: as many as a ring buffer may hold."""
FIRST_INTERVALS = 8
"""Intervals whose median gives the first period."""
RATE_FRAMES, CALM_FRAMES = 15, 5
"""Intervals whose median shows another frame rate (half a second at 30 fps); equally displaced frames that
show a moved phase, as two or three may be late by chance."""
TIMEOUT_FRAMES = 30
"""Frames after which a shift is given up: devices respond after 2 to 12 frames."""
NEIGHBOURS = 2
"""Frames on either side of one that tell an outlier from a line that is wrong."""
UNMISTAKABLE = 4.0
"""A single frame shows an expected shift if that exceeds the noise tolerance by this factor."""


@dataclass(frozen=True, slots=True)
class FrameStamp:
    """Sequence number and timestamp of one frame from the driver; time in ns of the node's local clock.

    `stream` counts the stream's starts: sequence numbers compare only within one stream.
    """

    sequence: int
    stream: int
    timestamp_ns: int


@dataclass(frozen=True, slots=True)
class StampError:
    """Error of one timestamp: its distance from the line of the stream's frames, and its error bar; ns."""

    outlier_ns: int = 0
    """Distance from the line of the stream's frames; if not 0, the line gives the frame's time."""
    uncertainty_ns: float = 0.0
    """95 % uncertainty of the frame's time, from the timestamps' noise and step."""
    hard_bound_ns: float = 0.0
    """Maximum error of the frame's time, from the timestamps' step."""


@dataclass(frozen=True, slots=True)
class PhaseEstimate:
    """Error of a stream against its grid at one instant of leader time."""

    error_ns: int
    """Signed distance of the nearest frame from the nearest grid instant, in [-period/2, period/2)."""
    period_ns: int
    """Camera's period in leader time; the drift gives it with finer resolution."""
    drift_ppm: float
    """Change of the error, in us per second."""
    sigma_ns: float
    """One standard deviation of the error from timestamp noise, without the clock's uncertainty."""
    frames: int
    """Frames since the phase last moved."""
    at_leader_ns: int
    quantum_error_ns: float = 0.0
    """Error that the step of the timestamps may hide, in either direction."""


class PendingShifts:
    """Commanded shifts of the phase, in effect or pending; times in ns, frames by their index."""

    def __init__(self) -> None:
        self.done_ns = 0
        self._waiting: deque[tuple[int, int]] = deque()
        self._latencies: deque[int] = deque([TYPICAL_LATENCY_FRAMES], maxlen=REMEMBERED_LATENCIES)
        self._newest = -LATENCY_FRAMES[1]
        self._felt = 0
        """Number of pending shifts that the newest frame has shown to be in effect."""
        self._seen: deque[tuple[int, int]] = deque(maxlen=REMEMBERED_FRAMES)
        """Index of each frame at which the effective shift changed, with the new sum."""

    @property
    def latency_frames(self) -> float:
        """Median number of frames from a command to its effect."""
        return median(self._latencies)

    @property
    def total_ns(self) -> int:
        """Sum of all shifts, including pending ones."""
        return self.done_ns + sum(shift_ns for _, shift_ns in self._waiting)

    def clear(self) -> None:
        """Remove all shifts: the stream restarts."""
        self.done_ns = self._felt = 0
        self._newest = -LATENCY_FRAMES[1]
        self._waiting.clear()
        self._seen.clear()

    def expect(self, index: int, shift_ns: int) -> None:
        """Add a shift that was commanded when `index` was the newest frame."""
        self._waiting.append((index, shift_ns))
        self._newest = index

    def all_in_effect(self, index: int) -> bool:
        """Whether every shift so far is certainly in effect at the frame `index`."""
        return index >= self._newest + LATENCY_FRAMES[1]

    def effective_at(self, index: int, seen_ns: float) -> int:
        """Return the sum of the shifts in effect at a frame `seen_ns` later than without any of them."""
        earliest, latest = LATENCY_FRAMES
        while self._waiting and index >= self._waiting[0][0] + latest:
            self.done_ns += self._waiting.popleft()[1]
            self._felt = max(0, self._felt - 1)
        best_ns = sum_ns = self.done_ns
        felt = 0
        for count, (commanded, shift_ns) in enumerate(self._waiting, 1):
            if index < commanded + earliest:
                break
            sum_ns += shift_ns
            if abs(seen_ns - sum_ns) < abs(seen_ns - best_ns):
                best_ns, felt = sum_ns, count
        if self._waiting and abs(seen_ns - best_ns) < abs(self._waiting[0][1]):
            self._latencies.extend(index - self._waiting[i][0] for i in range(self._felt, felt))
            self._felt = felt
        if not self._seen or self._seen[-1][1] != best_ns:
            self._seen.append((index, best_ns))
        return best_ns

    def seen_at(self, index: int) -> int:
        """Return the sum of the shifts in effect at a past frame, as that frame showed."""
        place = bisect_right(self._seen, index, key=lambda change: change[0])
        return self._seen[max(0, place - 1)][1] if self._seen else 0

    def certain_at(self, index: int) -> int:
        """Return the sum of the shifts certainly in effect at the frame `index`: observed, or overdue."""
        return self.done_ns + sum(
            shift_ns
            for count, (commanded, shift_ns) in enumerate(self._waiting)
            if count < self._felt or index >= commanded + LATENCY_FRAMES[1]
        )


class PhaseEstimator(FrameLine):
    """Period and phase of a stream of frames, robust to outliers, drops and phase moves."""

    def __init__(self, *, period_ns: int) -> None:
        super().__init__(period_ns=float(period_ns))
        self.frames = 0
        self.drops = 0
        self.last_shift_ns: int | None = None
        """Shift of the phase by the last disturbance, unwrapped, in ns; None if unknown."""
        self._stream: int | None = None
        self.last_ns = 0
        """Timestamp of the newest frame, in ns of local time."""
        self._sequence = self._origin_ns = self._index = 0
        self._quantum = StampQuantum()
        self._first_intervals: list[float] | None = []
        self._intervals: deque[float] = deque(maxlen=RATE_FRAMES)
        self.shifts = PendingShifts()
        self.disturbed = False
        """Whether the phase is moving or expected to move."""
        self._pending: list[Point] = []
        """Frames since a disturbance was first expected."""
        self._intercept_before_ns, self._begun_index = 0.0, 0
        self._expected_ns: float | None = None
        self.last_latency_frames: int | None = None
        """Frames from the start of the last disturbance until the phase had moved; None if unknown."""
        self.as_expected = False
        """Whether the last disturbance moved the phase to where it was expected."""

    @property
    def run_frames(self) -> int:
        """Number of frames since the phase last moved; 0 during a disturbance."""
        return 0 if self.disturbed else len(self.run)

    @property
    def run_begun_ns(self) -> int:
        """Timestamp of the first known frame since the phase last moved, in ns of local time."""
        return self._origin_ns + self.run[0][1]

    @property
    def unmoved(self) -> bool:
        """Whether the newest frame of a disturbance is still on the old line."""
        if not self.disturbed or not self._pending:
            return False
        off_ns = self.intercepts_of(self._pending[-1:])[0] - self._intercept_before_ns
        return abs(off_ns) < self.tolerance_ns / 2

    def add(self, stamp: FrameStamp) -> int:
        """Add a frame and return the number of frames dropped just before it.

        Frames of older streams, repeated frames and frames that go back in time are ignored.
        """
        if self._stream is None or stamp.stream > self._stream:
            self._start_stream(stamp)
            self.frames += 1
            return 0
        steps = stamp.sequence - self._sequence
        interval = stamp.timestamp_ns - self.last_ns
        if stamp.stream < self._stream or steps <= 0 or interval <= 0:
            return 0
        # Only a disturbance explains a long interval without a jump in the numbers.
        is_by_number = self.disturbed or self._first_intervals is not None
        advance = steps if is_by_number else max(1, round(interval / self.period_ns))
        dropped = steps - 1 if steps > 1 or self.disturbed else advance - 1
        self._sequence, self.last_ns = stamp.sequence, stamp.timestamp_ns
        self._index += advance
        self.frames += 1
        self.drops += dropped
        self._intervals.append(interval / steps)
        if not self.disturbed:
            self._quantum.add(interval)
            self.quantum_ns = self._quantum.ns
        if self._first_intervals is not None:
            self._measure_first_period(interval / steps)
        elif self._runs_at_another_rate():
            return dropped
        self._add_point()
        return dropped

    def nearest_frame_ns(self, local_ns: int) -> int:
        """Return the local time in ns of the frame nearest to a local time."""
        return round(self._time_at(self.index_near(local_ns)))

    def index_near(self, local_ns: int) -> int:
        """Return the index of the frame nearest to a local time in ns."""
        return self._index + round((local_ns - self._time_at(self._index)) / self.period_ns)

    def stamp_error(self, stamp_ns: int) -> StampError:
        """Return a timestamp's distance from its stream's line, 0 within the noise, and its uncertainties.

        A timestamp in coarse steps is corrected to the line if the line hides less than a step. Frames from
        before the last phase move are not compared with the line, as their own line is not stored.
        """
        step_ns, run = self.quantum_ns, self.run
        reported = StampError(0, max(step_ns, 2.0 * self.noise_ns), step_ns)
        is_comparable = not self.disturbed and self.known and len(run) >= PHASE_FRAMES
        if not is_comparable or stamp_ns < self.run_begun_ns:
            return reported
        off_ns, sigma_ns = stamp_ns - self.nearest_frame_ns(stamp_ns), self.sigma_at(stamp_ns)
        line_ns = self.quantum_error_ns + 2.0 * sigma_ns
        if line_ns < step_ns and self.shifts.all_in_effect(self.index_near(stamp_ns)):
            return StampError(off_ns, line_ns, step_ns)
        limit_ns = self.tolerance_ns + 3.0 * sigma_ns
        outlier = abs(off_ns) > limit_ns and abs(off_ns - self._neighbours_off_ns(stamp_ns)) > limit_ns
        return StampError(off_ns, step_ns, step_ns) if outlier else reported

    def _neighbours_off_ns(self, stamp_ns: int) -> float:
        """Return the median distance in ns from the line of the frames around one, itself included.

        A clock that is slewed leaves the line with all frames; an outlier leaves it alone.
        """
        index, run = self.index_near(stamp_ns), self.run
        low, high = (bisect_left(run, (at, 0)) for at in (index - NEIGHBOURS, index + NEIGHBOURS + 1))
        offs = [intercept - self.intercept_ns for intercept in self.intercepts_of(run[low:high])]
        return median(offs) if offs else 0.0

    def sigma_at(self, local_ns: int) -> float:
        """Return one standard deviation in ns of a predicted frame time near a local time."""
        used = min(self.phase_frames, max(1, self.run_frames))
        ahead = (local_ns - self.last_ns) / self.period_ns + used / 2
        drift = self.period_sigma_ns * abs(ahead) if self.period_sigma_ns < self.period_ns else 0.0
        return sqrt((MEDIAN_FACTOR * self.noise_ns) ** 2 / used + drift**2)

    def first_off_ns(self) -> float:
        """Return the distance in ns from the line of the first frame since the last phase move."""
        return abs(self.intercepts_of(self.run[:1])[0] - self.intercept_ns)

    def shift_to_come(self, local_ns: int) -> int:
        """Return the expected shifts in ns that may not be in effect yet at the frame near a local time."""
        return self.shifts.total_ns - self.shifts.certain_at(self.index_near(local_ns))

    def expect_shift(self, shift_ns: int) -> None:
        """Expect the coming frames to be later by exactly `shift_ns`, from one of the next few on."""
        self.shifts.expect(self._index, shift_ns)

    def mark_disturbance(self, expected_ns: float | None = None) -> None:
        """Expect the phase to move within TIMEOUT_FRAMES; `last_shift_ns` then holds the measured shift.

        `expected_ns` is the expected shift; None if it is uncertain.
        """
        if self._stream is None:
            return
        self.disturbed, self._expected_ns = True, expected_ns
        self.last_shift_ns, self.last_latency_frames, self.as_expected = None, None, False
        self._pending.clear()
        self._begun_index, self._intercept_before_ns = self._index, self.intercept_ns

    def _start_stream(self, stamp: FrameStamp) -> None:
        self._stream, self._sequence, self.last_ns = stamp.stream, stamp.sequence, stamp.timestamp_ns
        self.last_shift_ns, self.as_expected = None, False
        self.disturbed = False
        self.begin_run()
        self.shifts.clear()
        self._index, self._origin_ns = 0, stamp.timestamp_ns
        self._add_point()

    def _measure_first_period(self, period: float) -> None:
        """Measure the first period: the camera's may differ from the one requested of it."""
        assert self._first_intervals is not None
        self._first_intervals.append(period)
        if len(self._first_intervals) < FIRST_INTERVALS:
            return
        self.period_ns = median(self._first_intervals)
        self._first_intervals = None
        # With the period known, the times show drops that the sequence numbers did not.
        for run in self.runs:
            index = 0
            for i, (_, time_ns) in enumerate(run):
                index += max(1, round((time_ns - run[i - 1][1]) / self.period_ns)) if i else 0
                run[i] = (index, time_ns)
        run = self.run
        self._index = run[-1][0] + max(
            1, round((self.last_ns - self._origin_ns - run[-1][1]) / self.period_ns)
        )

    def _runs_at_another_rate(self) -> bool:
        """Restart with a new period if the frame rate changed (a webcam halves it in the dark).

        Return whether it did.
        """
        if self.disturbed or len(self._intervals) < RATE_FRAMES:
            return False
        period = median(self._intervals)
        if abs(period - self.period_ns) <= max(0.02 * self.period_ns, 2.0 * self.noise_ns):
            return False
        self.begin_at_rate(period)
        self._index, self._origin_ns = 0, self.last_ns
        self.shifts.clear()
        return True

    def _add_point(self) -> None:
        elapsed_ns = self.last_ns - self._origin_ns
        seen_ns = self.intercepts_of([(self._index, elapsed_ns)])[0] - self.intercept_ns
        point = (self._index, elapsed_ns - self.shifts.effective_at(self._index, seen_ns))
        if self.disturbed:
            self._pending.append(point)
            self._end_disturbance()
            return
        self.add_point(point, fit=self._first_intervals is None)
        if self._first_intervals is None:
            self._notice_jump()

    def _time_at(self, index: int) -> float:
        # Shifts after a past frame were not yet in effect at it.
        shifted_ns = self.shifts.seen_at(index) if index < self._index else self.shifts.certain_at(index)
        return self._origin_ns + self.intercept_ns + self.period_ns * index + shifted_ns

    def _end_disturbance(self) -> None:
        """End a disturbance once the last frames are on a line again that is shifted from the old one.

        After a timeout the line need not be shifted; after twice that, the disturbance ends in any case.
        """
        intercepts = self.intercepts_of(self._pending)
        if not (count := self._frames_as_expected(intercepts)):
            count, last = CALM_FRAMES, intercepts[-CALM_FRAMES:]
            if len(last) < CALM_FRAMES:
                return
            calm = max(last) - min(last) < self.tolerance_ns
            shift_ns = median(last) - self._intercept_before_ns
            moved = abs(shift_ns) > max(4.0 * self.noise_ns, 2_000.0)
            if self._expected_ns is not None:
                moved = moved and abs(shift_ns - self._expected_ns) < abs(shift_ns)
            if not (calm and moved) and len(self._pending) < TIMEOUT_FRAMES:
                return
            if not calm and len(self._pending) < 2 * TIMEOUT_FRAMES:
                return
        last_points = self._pending[-count:]
        self.disturbed = False
        self.begin_run(last_points)
        self.last_shift_ns = round(self.intercept_ns - self._intercept_before_ns)
        self.last_latency_frames = last_points[0][0] - self._begun_index

    def _frames_as_expected(self, intercepts: list[float]) -> int:
        """Return the number of newest frames that show the phase moved as expected; 0 while that is open."""
        if self._expected_ns is None:
            return 0
        needed = 1 if abs(self._expected_ns) > UNMISTAKABLE * self.tolerance_ns else CALM_FRAMES
        off_ns = [
            intercept - self._intercept_before_ns - self._expected_ns for intercept in intercepts[-needed:]
        ]
        self.as_expected = len(off_ns) == needed and max(map(abs, off_ns)) < self.tolerance_ns / 2
        return needed if self.as_expected else 0

    def _notice_jump(self) -> None:
        """Start a new run if the last frames all left the line: the camera moved by itself."""
        run = self.run
        if len(run) < 2 * CALM_FRAMES:
            return
        before = median(self.intercepts_of(run[-CALM_FRAMES - PHASE_FRAMES : -CALM_FRAMES]))
        off = [intercept - before for intercept in self.intercepts_of(run[-CALM_FRAMES:])]
        limit = max(8.0 * self.noise_ns, 20_000.0)
        if min(off) > limit or max(off) < -limit:
            self.split_off(CALM_FRAMES)
            self.last_shift_ns = None
