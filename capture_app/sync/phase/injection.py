"""Phase moves by single frames: one with a longer exposure (injection), or one of another duration.

An injection's shift is gain * row_time * (rows - neutral rows). Gain and neutral rows differ by device and
are fitted to observed injections. Most sensors hold a long frame's length for one, two or three frames (the
gain), but any real gain occurs. Whole gains are preferred until their residuals are too large. A frame
duration changes by whole rows, without changing the exposure. Far from the grid one frame takes the whole
shift; near it steps of a row hold the phase.
"""

from collections import deque
from itertools import combinations
from math import ceil, copysign, floor, sqrt
from statistics import median

from capture_app.common.camera_facts import CameraFacts
from capture_app.sync.phase.actuators import InjectionProfile, Move, PhaseActuator
from capture_app.sync.phase.frame_grid import (
    LARGEST_LEAD,
    Drift,
    Setpoint,
    setpoint_for_burst,
    setpoint_to_stay,
)
from capture_app.sync.phase.frame_line import SIGMA_FROM_MAD
from capture_app.sync.wire.camera_commands import InjectFrame, SetFrameDuration

GAINS, GAIN_LIMITS = (1.0, 2.0, 3.0), (0.5, 4.0)
"""Gains that are tried first, as those of most pipelines are whole, and limits of a gain that is not."""
REAL_GAIN = 1.2
"""Penalty in rows of mean residual on a gain that is not a whole number."""
MAX_RESIDUAL_ROWS = 20.0
"""Maximum residual in rows counted per injection: an outlier among the timestamps is not the gain's fault."""
APART_ROWS = 10.0
"""Minimum difference in rows between two injections that determine a gain."""
TYPICAL_ROW_NS = 12_000
"""Row time assumed if unknown."""
FINEST_NS = 1_000
"""Step of exposures if the row time is unknown."""
TYPICAL_OVERHEAD_NS = 250_000
"""Initial assumption of the time by which a frame is longer than its exposure."""
OVERHEAD_SCALE_NS = 1_000_000
"""Difference from it that costs a profile as much as one row of mean residual."""
NO_OVERHEAD = 10.0
"""Penalty in rows on a profile by which an exposure longer than the frame does not stretch it."""
REMEMBERED = 8
"""Newest injections to which the profile is fitted (chosen)."""
LEAD_FRAMES = 6
"""Frames from a command until the phase has moved, before any was observed: latency of 2-4, and long ones."""
WAIT_NS = 1_000_000_000
"""A stream that drifts into its tolerance by itself within this time is not moved."""
BURST_LEAD_FRAMES = 12
"""Frames from a command to a burst: four of latency, three long ones in the time of six, two spare."""
BURST_SPARE_FRAMES = 4
"""Frames between the longest observed latency and a burst: two that long ones add, two spare."""
RECORDING_NS = 120_000
"""Phase error in a recording at which one frame is moved, so that two cameras stay within 0.3 ms with the
error of the moves: a frame in ten seconds at 20 ppm."""
ENOUGH_LATENCIES = 3
"""Observed latencies from which on the longest one counts instead of BURST_LEAD_FRAMES."""
BURST_NOTICE_NS = 450_000_000
"""Notice of a burst: a leader orders it half a second ahead, less the order's delay."""
FIRST_GAIN, FIRST_STRETCH_NS, RAISE_NS = 2, 2_000_000, 1_000_000
"""The first injection: it assumes a gain between the smallest and the largest of GAINS, exceeds a period by
at least the second value, and by the third one more after each that showed no effect."""
INSIDE_ROW = 0.25
"""Fraction of a row added to exposures, so that drivers that truncate and drivers that round both fit."""
WORTHWHILE = 0.7
"""Maximum fraction of the error that an injection may leave; below a row, waiting for drift is better."""
INSIDE_TOLERANCE = 0.8
"""Fraction of the tolerance beyond which a landing is avoided if another number of rows allows it."""
SURE_ROWS = 1.0
"""Maximum residual in rows of an injection that confirms its profile."""
REMEMBERED_LATENCIES = 8
"""Latencies of which the longest is used: as many as injections (REMEMBERED)."""
FRUITLESS = 8
"""Consecutive frames exposed longer than a period without effect that show an immovable camera."""
FINE_ROWS = 16
"""Maximum rows of a small step, whose effect is taken for granted and is invisible in images."""
DEADBAND_ROWS = 0.55
"""Minimum predicted error in rows for a step of a row: over a half, so that noise causes no flicker."""


class InjectionHistory:
    """Last injections of one camera: rows exposed, and the resulting shift in rows."""

    def __init__(self, *, period_ns: int, row_time_ns: int | None) -> None:
        self.row_ns = row_time_ns or FINEST_NS
        """Unit of exposures: the row time, or FINEST_NS if that is unknown."""
        self.row_known = row_time_ns is not None
        self._grain = 1.0 if self.row_known else TYPICAL_ROW_NS / self.row_ns
        """Larger of the sensor's row and the timestamps' noise, in units of `row_ns`."""
        self._period_rows = period_ns / self.row_ns
        self._seen: deque[tuple[int, float]] = deque(maxlen=REMEMBERED)

    @property
    def moved(self) -> bool:
        """Whether any injection moved the phase; without one there is nothing to fit."""
        return any(shift for _, shift in self._seen)

    @property
    def idle_rows(self) -> int:
        """Longest exposure without effect, in rows; 0 if there was none."""
        return max((rows for rows, shift in self._seen if not shift), default=0)

    def add(self, rows: int, shift_rows: float, noise_rows: float) -> None:
        """Add an injection and the shift it caused, in rows; `noise_rows` is the noise of the timestamps.

        Residuals within that noise are not counted.
        """
        self._grain = max(self._grain, noise_rows)
        self._seen.append((rows, shift_rows))

    def miss_rows(self, profile: InjectionProfile, rows: int, shift_rows: float) -> float:
        """Return the residual of a shift against a profile, in the sensor's own rows."""
        return abs(shift_rows - profile.shift_rows(rows)) / self._grain

    def scatter_ns(self, profile: InjectionProfile) -> float:
        """Return the standard deviation of shifts about a profile in ns; 0 before two moves were seen."""
        if len(misses := [self.miss_rows(profile, *seen) for seen in self._seen if seen[1]]) < 2:
            return 0.0
        return (
            SIGMA_FROM_MAD
            * median(misses)
            * sqrt(len(misses) / (len(misses) - 1))
            * self._grain
            * self.row_ns
        )

    def fit(self) -> InjectionProfile:
        """Return the profile with the best-fitting gain; the overhead it implies is the tie-breaker.

        Candidates for a real gain come from pairs of injections, and from single ones at typical overhead.
        """
        idle = (self._period_rows - TYPICAL_OVERHEAD_NS / self.row_ns, 0.0)
        gains = [
            (shift - other) / (rows - base)
            for (base, other), (rows, shift) in combinations([idle, *self._seen], 2)
            if abs(rows - base) > APART_ROWS * self._grain
        ]
        real = [(gain, REAL_GAIN) for gain in gains if GAIN_LIMITS[0] <= gain <= GAIN_LIMITS[1]]
        fits = [self._fit_gain(gain, penalty) for gain, penalty in [*((g, 0.0) for g in GAINS), *real]]
        return min(fits, key=lambda fit: fit[0])[1]

    def _fit_gain(self, gain: float, penalty: float) -> tuple[float, InjectionProfile]:
        """Return the residual of a gain in rows, penalties included, and the profile fitted with it."""
        neutral = median([rows - shift / gain for rows, shift in self._seen if shift])
        if self.row_known and not penalty:
            neutral = float(round(neutral))
        profile = InjectionProfile(self.row_ns, gain, neutral)
        misses = [self.miss_rows(profile, *seen) for seen in self._seen]
        residual = penalty + sum(min(miss, MAX_RESIDUAL_ROWS) for miss in misses) / len(misses)
        overhead_ns = (self._period_rows - neutral) * self.row_ns
        residual += abs(overhead_ns - TYPICAL_OVERHEAD_NS) / OVERHEAD_SCALE_NS
        if overhead_ns < -2.0 * self._grain * self.row_ns:
            residual += NO_OVERHEAD
        return residual, profile


class InjectionActuator(PhaseActuator):
    """Phase moves by exposures; learns gain and neutral rows in one or two injections."""

    def __init__(self, camera: CameraFacts, profile: InjectionProfile | None = None) -> None:
        self._history = InjectionHistory(period_ns=camera.period_ns, row_time_ns=camera.row_time_ns)
        self._row_ns = self._history.row_ns
        self._period_ns = camera.period_ns
        self._min_ns = max(camera.min_exposure_ns or 0, camera.exposure_ns or 0)
        max_ns = camera.max_exposure_ns
        self._max_ns = 10 * camera.period_ns if max_ns is None else max_ns
        self._asked: int | None = None
        self._latencies: deque[int] = deque([LEAD_FRAMES], maxlen=REMEMBERED_LATENCIES)
        self._confirmed = True
        """Whether the last injection agreed with its profile."""
        self._raised_ns = 0
        self._in_vain = self._fruitless = 0
        """Consecutive injections without effect, and the number of them that were long enough to have one."""
        self.profile = profile
        """Injection profile; None until the first injection has shown its effect."""

    @property
    def problem(self) -> str:
        """Reason why this camera can never be moved: no long exposures, or none with an effect."""
        if self._fruitless >= FRUITLESS:
            return "its phase does not move after an order to expose one frame for longer"
        if self._max_ns >= self._period_ns + FIRST_STRETCH_NS:
            return ""
        return (
            f"its longest exposure of {self._max_ns / 1e6:.1f} ms is too short to move its phase;"
            f" {(self._period_ns + FIRST_STRETCH_NS) / 1e6:.1f} ms are needed"
        )

    @property
    def sure(self) -> bool:
        """Whether the next injection is expected to move the phase as commanded."""
        return self.profile is not None and self._confirmed and not self._in_vain

    @property
    def meets_bursts(self) -> bool:
        """Whether a stream can reach its grid between the order of a burst and its first instant."""
        return self.sure and self._burst_lead_frames * self._period_ns <= BURST_NOTICE_NS

    @property
    def _burst_lead_frames(self) -> int:
        seen = max(self._latencies) + BURST_SPARE_FRAMES
        return seen if len(self._latencies) > ENOUGH_LATENCIES else max(seen, BURST_LEAD_FRAMES)

    @property
    def expected_shift_ns(self) -> float | None:
        """Expected shift by the last injection, in ns; None if it is uncertain."""
        if self.profile is None or self._asked is None or not self.sure:
            return None
        return self.profile.shift_rows(self._asked) * self._row_ns

    def setpoint(
        self, drift: Drift, *, hold_ns: int, aligned: bool, common_instant_ns: int
    ) -> Setpoint | None:
        """Return the setpoint that keeps the stream within its tolerance longest; None if none is needed.

        The setpoint is the grid itself while the effect of an injection is uncertain.
        """
        lead_ns = max(self._latencies) * drift.period_ns
        if self.sure and drift.tolerance_ns * 2 < abs(drift.rate) * lead_ns:
            # The stream would leave again before the next injection counts: only bursts justify one.
            return None
        waits_ns = (lead_ns, WAIT_NS) if aligned else (lead_ns,)
        if any(abs(drift.error_after(later_ns)) <= drift.left_ns for later_ns in waits_ns):
            return None
        return setpoint_to_stay(drift, lead_ns, hold_ns if self.sure else 0)

    def setpoint_for_burst(self, drift: Drift, *, begins_ns: int, lasts_ns: int) -> Setpoint | None:
        """Return the setpoint to cross the grid in mid-burst; None if uncertain or not needed."""
        if not self.sure:
            return None
        lead_ns = max(self._latencies) * drift.period_ns
        ready_ns = self._burst_lead_frames * drift.period_ns
        scatter_ns = 0.0 if self.profile is None else self._history.scatter_ns(self.profile)
        return setpoint_for_burst(
            drift, lead_ns, ready_ns, scatter_ns, begins_ns=begins_ns, lasts_ns=lasts_ns
        )

    def setpoint_in_recording(self, drift: Drift) -> Setpoint | None:
        """Return the setpoint from which drift takes longest to the other end of RECORDING_NS, once there."""
        lead_ns = max(self._latencies) * drift.period_ns
        if not self.sure or abs(drift.error_after(lead_ns)) <= RECORDING_NS:
            return None
        aim_ns = copysign(LARGEST_LEAD * RECORDING_NS, -drift.rate)
        return Setpoint(lead_ns, aim_ns, aim_ns)

    def command(self, move: Move) -> InjectFrame | None:
        """Return a long exposure; a shift beyond the longest exposure is done in part."""
        self._asked = None
        if self.profile is None:
            stretch_ns = max(move.shift_ns / FIRST_GAIN, FIRST_STRETCH_NS) + self._raised_ns
            rows = floor((move.period_ns - TYPICAL_OVERHEAD_NS + stretch_ns) / self._row_ns)
        else:
            if (chosen := self._rows_for(self.profile, move)) is None:
                return None
            rows = chosen + floor(self._raised_ns / self._row_ns)
        rows = min(rows, self._max_rows())
        self._asked = rows
        return InjectFrame(max(self._min_ns, round((rows + INSIDE_ROW) * self._row_ns)))

    def learn(self, shift_ns: int | None, noise_ns: float, latency_frames: int | None) -> None:
        """Fit gain and neutral rows to all stored shifts; no shift only lengthens the next exposure."""
        rows, self._asked = self._asked, None
        if rows is None or shift_ns is None:
            return
        if shift_ns < max(0.75 * self._row_ns, 4.0 * noise_ns):
            # Too short to stretch any frame, so it shows nothing about longer ones. On a known device the
            # command was probably lost.
            self._in_vain += 1
            if rows * self._row_ns > self._period_ns:
                self._fruitless += 1
            else:
                self._history.add(rows, 0.0, noise_ns / self._row_ns)
                self.profile = self._history.fit() if self._history.moved else self.profile
            if self.profile is None:
                self._raised_ns += RAISE_NS
            return
        self._raised_ns = self._in_vain = self._fruitless = 0
        if latency_frames is not None:
            self._latencies.append(latency_frames)
        known, history, shift_rows = self.profile, self._history, shift_ns / self._row_ns
        history.add(rows, shift_rows, noise_ns / self._row_ns)
        self._confirmed = known is not None and history.miss_rows(known, rows, shift_rows) < SURE_ROWS
        if not self._confirmed:
            self.profile = history.fit()

    def _max_rows(self) -> int:
        return floor(self._max_ns / self._row_ns - INSIDE_ROW)

    def _rows_for(self, profile: InjectionProfile, move: Move) -> int | None:
        """Return the rows whose shift, modulo the period, comes closest; None if none is worthwhile.

        A gain of g gives steps of g rows, but a period is seldom a multiple of them. Adding whole periods
        makes the rows between them reachable.
        """
        step_ns = profile.gain * self._row_ns
        min_rows = max(profile.neutral_rows, self._history.idle_rows)
        best_rows, min_cost = None, WORTHWHILE * min(move.shift_ns, move.period_ns - move.shift_ns)
        for turns in range(max(2, ceil(profile.gain))):
            shift_ns = move.shift_ns + turns * move.period_ns
            below = floor(shift_ns / step_ns + profile.neutral_rows)
            for rows in (below, below + 1):
                late_ns = (rows - profile.neutral_rows) * step_ns - shift_ns
                # A landing outside the tolerance would need another injection, however close to the target.
                beyond_ns = abs(move.off_centre_ns + late_ns) - INSIDE_TOLERANCE * move.tolerance_ns
                cost = abs(late_ns) + max(0.0, beyond_ns)
                if min_rows < rows <= self._max_rows() and cost < min_cost:
                    best_rows, min_cost = rows, cost
        max_rows = self._max_rows()
        if (
            best_rows is None
            and profile.neutral_rows < max_rows < move.shift_ns / step_ns + profile.neutral_rows
        ):
            # Not possible with one exposure: use the longest one.
            return max_rows
        return best_rows


class FrameDurationActuator(PhaseActuator):
    """Phase moves by the duration of one frame; a step too long for one frame is done in part."""

    def __init__(self, camera: CameraFacts) -> None:
        """Without limits from the camera, a frame can only be made longer, up to four periods."""
        self._row_ns = camera.row_time_ns or FINEST_NS
        self._base_rows = round(camera.period_ns / self._row_ns)
        min_ns, max_ns = camera.min_frame_duration_ns, camera.max_frame_duration_ns
        min_ns = camera.period_ns if min_ns is None else min_ns
        max_ns = 4 * camera.period_ns if max_ns is None else max_ns
        self._min_rows = min(0, -((self._base_rows * self._row_ns - min_ns) // self._row_ns))
        self._max_rows = max(0, max_ns // self._row_ns - self._base_rows)
        self._fine_ns = FINE_ROWS * self._row_ns
        self._near_ns = max(self._fine_ns, FINE_ROWS * TYPICAL_ROW_NS)
        """Maximum error that is corrected in a burst, by one small step or by several."""
        self.shift_ns = 0
        """Effect of the last command on the phase, in ns."""

    @property
    def problem(self) -> str:
        """Reason why this camera can never be moved; empty if it can."""
        return "" if self._max_rows > 0 else "none of its frames can be made longer than the usual ones"

    @property
    def small_shift_ns(self) -> int | None:
        """Effect of the last command on the phase in ns; None if it is more than a small step."""
        return self.shift_ns if abs(self.shift_ns) <= self._fine_ns else None

    def setpoint(
        self, drift: Drift, *, hold_ns: int, aligned: bool, common_instant_ns: int
    ) -> Setpoint | None:
        """Return the grid itself as the setpoint: a step of a row costs nothing."""
        return Setpoint(drift.latency_frames * drift.period_ns, 0.0)

    def setpoint_on_hold(self, drift: Drift) -> Setpoint | None:
        """Return the setpoint nearest to the grid that a small step reaches; None if the grid is far away."""
        lead_ns = drift.latency_frames * drift.period_ns
        error_ns = drift.error_after(lead_ns)
        if abs(error_ns) > self._near_ns:
            return None
        earliest_ns = max(-self._fine_ns, self._min_rows * self._row_ns)
        return Setpoint(lead_ns, error_ns + min(max(-error_ns, earliest_ns), self._fine_ns))

    def command(self, move: Move) -> SetFrameDuration | None:
        """Return the duration of one frame; None while the error is within about half a row."""
        later_ns = move.shift_ns
        if later_ns > move.period_ns / 2:
            later_ns -= round(move.period_ns)
        if abs(later_ns) <= DEADBAND_ROWS * self._row_ns:
            return None
        rows = round(later_ns / self._row_ns)
        if rows < self._min_rows == 0:
            # Frames cannot be shortened: go forward by nearly a whole period.
            rows = round(move.shift_ns / self._row_ns)
        rows = min(max(rows, self._min_rows), self._max_rows)
        if rows == 0:
            return None
        self.shift_ns = rows * self._row_ns
        return SetFrameDuration(round((self._base_rows + rows + INSIDE_ROW) * self._row_ns))
