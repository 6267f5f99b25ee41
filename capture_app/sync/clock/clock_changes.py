"""Recent changes of two clocks' rates: whether one may change again, or has its former rate again."""

from enum import Enum, auto

from capture_app.sync.clock.likely_line import LONG_AGO_NS, SKEW

CHANGE_SKEW, SHOWN_NS = 2.0 * SKEW, 10_000_000_000
"""Smallest rate change that is reported, two sigma of the skew of two crystals, and the time in which it must
have shown: a crystal that warms up takes longer."""
FAST_SKEW = 200e-6
"""Smallest rate change whose end is trusted when the former rate is back: time daemons slew by 500 ppm. A
smaller one, as of a kernel's discipline, fades: it may go on unseen."""
AGAIN_NS = 1_000_000_000
"""A clock that changes again within this time is slewed fast, too fast for its rate to be measured."""
BACK_SKEW = 100e-6
"""Distance from the former rate within which it is back, its 95 % error included: far below FAST_SKEW."""
SLEWED_NS = 30_000_000_000
"""Time for which a clock that has changed may change again: what slews a clock also ends."""


class ClockState(Enum):
    """Whether a line through the latest samples can be trusted."""

    STEADY = auto()
    """Neither clock has changed lately."""
    CHANGED = auto()
    """One has, and may change again."""
    RESTORED = auto()
    """One was stepped, or slewed fast, and has its former rate again."""


class ClockChanges:
    """The changes that were found lately, by a node's local time in ns; skews are dimensionless."""

    def __init__(self) -> None:
        self.state = ClockState.STEADY
        self.rate_changed_ns: int | None = None
        """Local time of the last significant change of a clock's rate."""
        self._shown_ns = self._newest_ns = LONG_AGO_NS
        """Local times of the last change that may be a rate change, and of the newest one."""
        self._skew_then = self._skew_before = 0.0
        """Skew before that change, and before the first of those since the clock was last steady."""
        self._was_fast = False
        """Whether they were fast, so that their end is known from noise."""

    def note(self, local_ns: int, skew_before: float, *, is_step: bool = False) -> None:
        """Note that a clock has changed, by a step or by its rate."""
        if local_ns - self._shown_ns > SHOWN_NS:
            self._shown_ns, self._skew_then = local_ns, skew_before
        if self.state is ClockState.STEADY:
            self._skew_before, self._was_fast = skew_before, False
        self._was_fast |= is_step or local_ns - self._newest_ns < AGAIN_NS
        self.state, self._newest_ns = ClockState.CHANGED, local_ns

    def judge(self, local_ns: int, skew: float, error: float, *, is_known: bool) -> None:
        """Judge by the newest line's skew and its 95 % error; `is_known` if its samples bear that out."""
        since_ns, change = local_ns - self._newest_ns, abs(skew - self._skew_before)
        if local_ns - self._shown_ns <= SHOWN_NS and abs(skew - self._skew_then) > CHANGE_SKEW + error:
            self.rate_changed_ns = self._shown_ns
        self._was_fast |= is_known and change - error > FAST_SKEW
        if since_ns >= SLEWED_NS:
            self.state = ClockState.STEADY
        elif self._was_fast:
            is_back = is_known and change + error < BACK_SKEW
            self.state = ClockState.RESTORED if is_back else ClockState.CHANGED
