"""Frame injection: one long frame moves the phase by gain * row_time * (rows - neutral rows).

Gain and neutral rows differ by device and are learned from what the injections do.
"""

from collections import deque
from math import ceil, floor

from capture_app.sync.phase.actuator import Move, MoveEffect, PhaseActuator
from capture_app.sync.phase.aim import Aim, Course, aim_at_burst, aim_to_stay
from capture_app.sync.phase.injection_history import USUAL_OVERHEAD_NS, InjectionHistory, InjectionProfile
from capture_app.sync.wire.camera_commands import InjectFrame

LEAD_FRAMES = 6
"""From the command until the phase has moved, before any was seen: 2-4 frames of latency, long ones."""
WAIT_NS = 1_000_000_000
"""A stream that drifts into its tolerance by itself within this is let."""
BURST_LEAD_FRAMES = 12
"""From the command to a burst: four of latency, three long ones in the time of six, two to spare."""
BURST_SPARE_FRAMES = 4
"""From the longest latency seen to a burst, once enough were: two that long ones add, two to spare."""
ENOUGH_LATENCIES = 3
BURST_NOTICE_NS = 450_000_000
"""A leader orders a burst half a second ahead, and the order takes its time."""
FIRST_GAIN = 2
FIRST_STRETCH_NS = 2_000_000
RAISE_NS = 1_000_000
INSIDE_ROW = 0.25
"""Exposures are asked for a quarter of a row above a whole one: right for drivers that cut or round."""
WORTHWHILE = 0.7
"""An injection must leave at most this share of the error; below a row, waiting for drift is better."""
TURN_ROWS = 0.1
INSIDE_TOLERANCE = 0.8
"""Landing beyond this share of the tolerance is avoided where another number of rows allows it."""
SURE_ROWS = 1.0
"""An injection whose shift differs from its profile's by less than this confirms the profile."""
REMEMBERED_LATENCIES = 8
LOST_COMMANDS = 2
"""So many injections without effect are repeated unchanged, where a device is known."""
FRUITLESS = 8
"""So many frames in a row exposed for longer than a period, and no effect: this camera cannot be moved."""


class InjectionActuator(PhaseActuator):
    """Turns wished shifts into exposures; learns gain and neutral rows in one or two injections."""

    def __init__(
        self,
        *,
        period_ns: int,
        row_time_ns: int | None,
        min_exposure_ns: int | None = None,
        max_exposure_ns: int | None = None,
        profile: InjectionProfile | None = None,
    ) -> None:
        self._history = InjectionHistory(period_ns=period_ns, row_time_ns=row_time_ns)
        self._row_ns = self._history.row_ns
        self._period_ns = period_ns
        self._min_ns = min_exposure_ns or 0
        self._max_ns = max_exposure_ns if max_exposure_ns is not None else 10 * period_ns
        self._asked: int | None = None
        self._latencies: deque[int] = deque([LEAD_FRAMES], maxlen=REMEMBERED_LATENCIES)
        self._confirmed = True
        """Whether the last injection did what the profile had said."""
        self._raised_ns = 0
        self._in_vain = self._fruitless = 0
        """Injections in a row without effect, and those of them that must have had one."""
        self.profile = profile
        """None until the first injection showed what it does."""

    @property
    def problem(self) -> str:
        """Why this camera can never be moved: long exposures are out of its reach, or change nothing."""
        if self._fruitless >= FRUITLESS:
            return "its phase does not move when it is told to expose one frame for longer"
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
        """Whether a stream can be brought to its goal between the order of a burst and its first instant."""
        return self.sure and self._burst_lead_frames * self._period_ns <= BURST_NOTICE_NS

    @property
    def _burst_lead_frames(self) -> int:
        seen = max(self._latencies) + BURST_SPARE_FRAMES
        return seen if len(self._latencies) > ENOUGH_LATENCIES else max(seen, BURST_LEAD_FRAMES)

    @property
    def expected_shift_ns(self) -> float | None:
        """How far the last injection moves the phase, None where that is not sure."""
        if self.profile is None or self._asked is None or not self.sure:
            return None
        return self.profile.shift_rows(self._asked) * self._row_ns

    def aim(self, course: Course, *, hold_ns: int, aligned: bool, meeting_ns: int) -> Aim | None:
        """Where the stream stays within its tolerance for longest; None if it is going to be within it.

        Right at the goal while it is not sure where it lands.
        """
        lead_ns = max(self._latencies) * course.period_ns
        if self.sure and course.tolerance_ns * 2 < abs(course.drift) * lead_ns:
            # It would be out again before the next injection counts: only bursts are worth one.
            return None
        waits_ns = (lead_ns, WAIT_NS) if aligned else (lead_ns,)
        if any(abs(course.error_after(later_ns)) <= course.left_ns for later_ns in waits_ns):
            return None
        return aim_to_stay(course, lead_ns, hold_ns if self.sure else 0)

    def aim_before_burst(self, course: Course, *, begins_ns: int, lasts_ns: int) -> Aim | None:
        """Where the stream meets its goal in the middle of a burst; None where the effect is not sure."""
        if not self.sure:
            return None
        lead_ns = max(self._latencies) * course.period_ns
        ready_ns = self._burst_lead_frames * course.period_ns
        scatter_ns = 0.0 if self.profile is None else self._history.scatter_ns(self.profile)
        return aim_at_burst(course, lead_ns, ready_ns, scatter_ns, begins_ns=begins_ns, lasts_ns=lasts_ns)

    def command(self, move: Move) -> InjectFrame | None:
        """One long frame; a shift that takes more than the longest exposure is done in part."""
        self._asked = None
        if self.profile is None:
            stretch_ns = max(move.shift_ns / FIRST_GAIN, FIRST_STRETCH_NS) + self._raised_ns
            rows = floor((move.period_ns - USUAL_OVERHEAD_NS + stretch_ns) / self._row_ns)
        else:
            chosen = self._rows_for(self.profile, move)
            if chosen is None:
                return None
            rows = chosen + floor(self._raised_ns / self._row_ns)
        rows = min(rows, self._most_rows())
        self._asked = rows
        return InjectFrame(max(self._min_ns, round((rows + INSIDE_ROW) * self._row_ns)))

    def learn(self, effect: MoveEffect) -> None:
        """Fit gain and neutral rows to all shifts remembered; no shift at all only raises the next one."""
        rows, self._asked = self._asked, None
        if rows is None or effect.shift_ns is None:
            return
        if effect.shift_ns < max(0.75 * self._row_ns, 4.0 * effect.noise_ns):
            # Too short to stretch a frame at all, it teaches nothing about longer ones. With a known
            # device the command was lost, more likely.
            self._in_vain += 1
            if rows * self._row_ns > self._period_ns:
                self._fruitless += 1
            else:
                self._history.add(rows, 0.0, effect.noise_ns / self._row_ns)
                self.profile = self._history.fit() if self._history.moved else self.profile
            if self.profile is None or self._in_vain > LOST_COMMANDS:
                self._raised_ns += RAISE_NS
            return
        self._raised_ns = self._in_vain = self._fruitless = 0
        if effect.latency_frames is not None:
            self._latencies.append(effect.latency_frames)
        known, history, shift_rows = self.profile, self._history, effect.shift_ns / self._row_ns
        history.add(rows, shift_rows, effect.noise_ns / self._row_ns)
        self._confirmed = known is not None and history.miss_rows(known, rows, shift_rows) < SURE_ROWS
        if not self._confirmed:
            self.profile = history.fit()

    def _most_rows(self) -> int:
        return floor(self._max_ns / self._row_ns - INSIDE_ROW)

    def _rows_for(self, profile: InjectionProfile, move: Move) -> int | None:
        """Rows whose shift, whole periods aside, comes nearest; None if no shift comes as near.

        A gain of g moves in steps of g rows, but a period is seldom a multiple of them: with some whole
        periods more, the rows between them come into reach.
        """
        step_ns = profile.gain * self._row_ns
        least_rows = max(profile.neutral_rows, self._history.idle_rows)
        worth_ns = WORTHWHILE * min(move.shift_ns, move.period_ns - move.shift_ns)
        best_rows, least = None, float("inf")
        for turns in range(max(2, ceil(profile.gain))):
            shift_ns = move.shift_ns + turns * move.period_ns
            neutral_rows = self._history.neutral_near(profile, shift_ns / self._row_ns)
            below = floor(shift_ns / step_ns + neutral_rows)
            for rows in (below, below + 1):
                late_ns = (rows - neutral_rows) * step_ns - shift_ns
                # A whole period more is only worth it where it comes nearer by a good part of a row.
                cost = abs(late_ns) + turns * TURN_ROWS * self._row_ns
                # Beyond the tolerance it would have to be done again, however near it is to the aim.
                cost += max(0.0, abs(move.aim_ns + late_ns) - INSIDE_TOLERANCE * move.tolerance_ns)
                doubted = cost + self._history.doubt_rows(profile, rows) * self._row_ns
                if least_rows < rows <= self._most_rows() and cost < worth_ns and doubted < least:
                    best_rows, least = rows, doubted
        most = self._most_rows()
        if best_rows is None and profile.neutral_rows < most < move.shift_ns / step_ns + profile.neutral_rows:
            # Out of reach in one go: as far as the longest exposure gets.
            return most
        return best_rows
