"""Frame injection: one long frame moves the phase by gain * row_time * (rows - neutral rows).

Sensors stretch a frame in whole rows, and hold the stretch for one to three frames (the gain). Gain and
neutral rows differ by device and are learned from what the injections do.
"""

from collections import deque
from dataclasses import dataclass
from math import floor
from statistics import median

from capture_app.sync.phase.actuator import Move, MoveEffect, PhaseActuator
from capture_app.sync.phase.aim import Aim, Course, aim_at_burst, aim_to_stay
from capture_app.sync.wire.camera_commands import InjectFrame

LEAD_FRAMES = 9
"""From the command until the phase is known again: 2-4 frames of latency, the long ones, five calm ones."""
BURST_LEAD_FRAMES = 12
"""From the command to a burst: four of latency, three long ones in the time of six, two to spare."""
GAINS = (1, 2, 3)
FIRST_GAIN = 2
USUAL_OVERHEAD_NS = 250_000
"""Time that a frame is longer than its exposure, where nothing is known yet."""
OVERHEAD_SPREAD_NS = 1_000_000
FIRST_STRETCH_NS = 2_000_000
RAISE_NS = 1_000_000
INSIDE_ROW = 0.25
"""Exposures are asked for a quarter of a row above a whole one: right for drivers that cut or round."""
FINEST_NS = 1_000
"""Step of exposures where the row time is not known."""
WORTHWHILE = 0.7
"""An injection must leave at most this share of the error; below a row, waiting for drift is better."""
TURN_ROWS = 0.1
INSIDE_TOLERANCE = 0.8
"""Landing beyond this share of the tolerance is avoided where another number of rows allows it."""
SURE_ROWS = 1.0
"""An injection whose shift differs from its profile's by less than this confirms the profile."""
LOST_COMMANDS = 2
"""So many injections without effect are repeated unchanged, where a device is known."""
FRUITLESS = 8
"""Injections in a row without any effect after which a camera counts as one that cannot be moved."""
REMEMBERED = 8


@dataclass(frozen=True, slots=True)
class InjectionProfile:
    """How a device responds to a long frame, kept for its next use."""

    row_time_ns: int
    gain: int
    neutral_rows: float
    """Longest exposure that does not stretch a frame, in rows."""


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
        self._row_ns = row_time_ns or FINEST_NS
        self._row_known = row_time_ns is not None
        self._period_ns = period_ns
        self._min_ns = min_exposure_ns or 0
        self._max_ns = max_exposure_ns if max_exposure_ns is not None else 10 * period_ns
        self._seen: deque[tuple[int, float]] = deque(maxlen=REMEMBERED)
        self._asked: int | None = None
        self._raised_ns = 0
        self._fruitless = 0
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
        if self.profile is None or self._fruitless:
            return False
        if not self._seen:
            return True
        rows, shift_rows = self._seen[-1]
        return abs(self.profile.gain * (rows - self.profile.neutral_rows) - shift_rows) < SURE_ROWS

    def aim(self, course: Course, *, hold_ns: int, aligned: bool, meeting_ns: int) -> Aim | None:
        """Where the stream stays within its tolerance for longest; None if it is going to be within it."""
        lead_ns = LEAD_FRAMES * course.period_ns
        return (
            None if course.tolerates(course.error_after(lead_ns)) else aim_to_stay(course, lead_ns, hold_ns)
        )

    def aim_before_burst(self, course: Course, *, begins_ns: int, lasts_ns: int) -> Aim | None:
        """Where the stream meets its goal in the middle of a burst; None where the effect is not sure."""
        if not self.sure:
            return None
        lead_ns, ready_ns = (frames * course.period_ns for frames in (LEAD_FRAMES, BURST_LEAD_FRAMES))
        return aim_at_burst(course, lead_ns, ready_ns, begins_ns, lasts_ns)

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
        if effect.shift_ns < max(0.75 * self._row_ns if self._row_known else 0.0, 4.0 * effect.noise_ns):
            # Too short to stretch a frame at all, it teaches nothing about longer ones. With a known
            # device the command was lost, more likely.
            self._fruitless += 1
            if self.profile is None or self._fruitless > LOST_COMMANDS:
                self._raised_ns += RAISE_NS
            return
        self._raised_ns = self._fruitless = 0
        self._seen.append((rows, effect.shift_ns / self._row_ns))
        self.profile = self._fit()

    def _most_rows(self) -> int:
        return floor(self._max_ns / self._row_ns - INSIDE_ROW)

    def _rows_for(self, profile: InjectionProfile, move: Move) -> int | None:
        """Rows whose shift, whole periods aside, comes nearest; None if no shift comes as near.

        A gain of g moves in steps of g rows, but a period is seldom a multiple of them: with 0 to g - 1
        whole periods more, all rows between them come into reach.
        """
        step_ns = profile.gain * self._row_ns
        best_rows, least = None, WORTHWHILE * min(move.shift_ns, move.period_ns - move.shift_ns)
        for turns in range(max(2, profile.gain)):
            shift_ns = move.shift_ns + turns * move.period_ns
            below = floor(shift_ns / step_ns + profile.neutral_rows)
            for rows in (below, below + 1):
                late_ns = (rows - profile.neutral_rows) * step_ns - shift_ns
                # A whole period more is only worth it where it comes nearer by a good part of a row.
                cost = abs(late_ns) + turns * TURN_ROWS * self._row_ns
                # Beyond the tolerance it would have to be done again, however near it is to the aim.
                cost += max(0.0, abs(move.aim_ns + late_ns) - INSIDE_TOLERANCE * move.tolerance_ns)
                if profile.neutral_rows < rows <= self._most_rows() and cost < least:
                    best_rows, least = rows, cost
        most = self._most_rows()
        if best_rows is None and profile.neutral_rows < most < move.shift_ns / step_ns + profile.neutral_rows:
            # Out of reach in one go: as far as the longest exposure gets.
            return most
        return best_rows

    def _fit(self) -> InjectionProfile:
        """The gain whose line fits best, with the overhead it implies as a tie-breaker."""
        best: InjectionProfile | None = None
        least = float("inf")
        for gain in GAINS:
            neutral = median([rows - shift / gain for rows, shift in self._seen])
            if self._row_known:
                neutral = float(round(neutral))
            misses = [abs(shift - gain * (rows - neutral)) for rows, shift in self._seen]
            # Over one row, a misfit counts in full: an outlier among the timestamps is not the gain's fault.
            misfit = sum(min(miss, 20.0) for miss in misses) / len(misses)
            overhead_ns = self._period_ns - neutral * self._row_ns
            misfit += abs(overhead_ns - USUAL_OVERHEAD_NS) / OVERHEAD_SPREAD_NS
            if overhead_ns < -2.0 * self._row_ns:
                misfit += 10.0
            if misfit < least:
                best, least = InjectionProfile(self._row_ns, gain, neutral), misfit
        assert best is not None
        return best
