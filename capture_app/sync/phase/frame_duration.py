"""Frame-duration control: single frames are made longer or shorter by whole rows.

Far from the goal one frame takes the whole shift; near it one row at a time holds the phase to half a row,
without any frame with another exposure.
"""

from capture_app.sync.phase.actuator import Move, MoveEffect, PhaseActuator
from capture_app.sync.phase.aim import Aim, Course
from capture_app.sync.phase.injection import INSIDE_ROW
from capture_app.sync.phase.injection_history import FINEST_NS
from capture_app.sync.wire.camera_commands import SetFrameDuration

FINE_ROWS = 16
"""Up to so many rows a step is small: its effect is taken for granted, and no picture suffers."""
DEADBAND_ROWS = 0.55
"""A row is given where the predicted error exceeds this: over a half, or noise would make it flicker."""


class FrameDurationActuator(PhaseActuator):
    """Turns wished shifts into the duration of one frame; a step too long for one frame is done in part."""

    def __init__(
        self,
        *,
        period_ns: int,
        row_time_ns: int | None,
        min_duration_ns: int | None = None,
        max_duration_ns: int | None = None,
    ) -> None:
        """Without limits, a frame can only be made longer, up to four periods."""
        self._row_ns = row_time_ns or FINEST_NS
        self._base_rows = round(period_ns / self._row_ns)
        least_ns = period_ns if min_duration_ns is None else min_duration_ns
        most_ns = 4 * period_ns if max_duration_ns is None else max_duration_ns
        self._least_rows = min(0, -((self._base_rows * self._row_ns - least_ns) // self._row_ns))
        self._most_rows = max(0, most_ns // self._row_ns - self._base_rows)
        self.shift_ns = 0
        """What the last command does to the phase, in ns."""

    @property
    def problem(self) -> str:
        """Why this camera can never be moved."""
        if self._most_rows > 0:
            return ""
        return "none of its frames can be made longer than the usual ones"

    @property
    def fine_ns(self) -> int:
        """Largest shift in ns that is a small step."""
        return FINE_ROWS * self._row_ns

    @property
    def small_shift_ns(self) -> int | None:
        """What the last command does to the phase, None where it is more than a small step."""
        return self.shift_ns if abs(self.shift_ns) <= self.fine_ns else None

    def aim(self, course: Course, *, hold_ns: int, aligned: bool, meeting_ns: int) -> Aim | None:
        """Straight at the goal: a step of a row costs nothing."""
        lead_ns = course.latency_frames * course.period_ns
        return Aim(lead_ns, course.error_after(lead_ns), 0.0, 0.0)

    def aim_on_hold(self, course: Course) -> Aim | None:
        """At the goal, if it is a few rows away at most: such a step shows in no picture."""
        lead_ns = course.latency_frames * course.period_ns
        error_ns = course.error_after(lead_ns)
        return None if abs(error_ns) > self.fine_ns else Aim(lead_ns, error_ns, 0.0, 0.0)

    def command(self, move: Move) -> SetFrameDuration | None:
        """The duration of one frame; None while the error is within about half a row."""
        later_ns = move.shift_ns
        if later_ns > move.period_ns / 2:
            later_ns -= round(move.period_ns)
        if abs(later_ns) <= DEADBAND_ROWS * self._row_ns:
            return None
        rows = round(later_ns / self._row_ns)
        if rows < self._least_rows == 0:
            # Frames cannot be made shorter: the way round, by nearly a whole period, is the only one.
            rows = round(move.shift_ns / self._row_ns)
        rows = min(max(rows, self._least_rows), self._most_rows)
        if rows == 0:
            return None
        self.shift_ns = rows * self._row_ns
        return SetFrameDuration(round((self._base_rows + rows + INSIDE_ROW) * self._row_ns))

    def learn(self, effect: MoveEffect) -> None:
        """Nothing: the effect of a row is known exactly."""
