"""Frame grid of a rig: the instants at which all its cameras take their frames, and setpoints against it.

A setpoint is the target of a phase move, chosen so that drift takes the stream through the grid when it
matters.
"""

from dataclasses import dataclass

LARGEST_LEAD = 0.6
"""Maximum distance past the grid in anticipation of drift, as a fraction of the tolerance; a quarter of that
if half the tolerance is to be met."""
BURST_FRACTION = 0.25
"""Fraction of the tolerance beyond which a burst's predicted error is corrected in advance."""
SHORT_BURST_NS = 2_000_000_000
"""Longest burst that drift always crosses in its middle."""


@dataclass(frozen=True, slots=True)
class FrameGrid:
    """Grid of instants to which all cameras are moved: anchor + k * period, in leader time."""

    anchor_leader_ns: int
    period_ns: int

    def index_of(self, leader_ns: int) -> int:
        """Return the number of the grid instant nearest to a leader time in ns."""
        return (leader_ns - self.anchor_leader_ns + self.period_ns // 2) // self.period_ns

    def instant(self, index: int) -> int:
        """Return the leader time in ns of the grid instant `index`."""
        return self.anchor_leader_ns + index * self.period_ns

    def phase_error(self, leader_ns: int) -> int:
        """Return the distance in ns from the nearest grid instant, in [-period/2, period/2)."""
        return leader_ns - self.instant(self.index_of(leader_ns))


@dataclass(frozen=True, slots=True)
class Drift:
    """Phase error of a stream now (ns), its rate of change (ns per ns), and the limits for its correction."""

    error_ns: float
    rate: float
    period_ns: float
    tolerance_ns: int
    grace_ns: float
    """Added to the tolerance, so that noise does not make a phase at its limit flicker in and out."""
    latency_frames: float = 0.0
    """Frames from a small step's command to its effect."""
    left_ns: float = 0.0
    """Errors up to this are not corrected."""
    landing_fraction: float = 1.0
    """Fraction of the tolerance within which a move should bring the stream."""

    def error_after(self, ns: float) -> float:
        """Return the error in ns after a time in ns, if nothing moves the stream."""
        return self.error_ns + self.rate * ns

    def tolerates(self, error_ns: float) -> bool:
        """Whether an error needs no correction."""
        return abs(error_ns) <= self.tolerance_ns + self.grace_ns


@dataclass(frozen=True, slots=True)
class Setpoint:
    """Phase error that a correction aims at, for when it takes effect, `lead_ns` from now; in ns."""

    lead_ns: float
    target_ns: float
    """Phase error to have at that time; not 0 where drift is anticipated."""
    off_centre_ns: float = 0.0
    """Distance of the target itself from the grid, in anticipation of drift."""


def setpoint_to_stay(drift: Drift, lead_ns: float, hold_ns: int) -> Setpoint:
    """Return the setpoint that keeps a stream within its tolerance longest: drift crosses the middle."""
    furthest_ns = LARGEST_LEAD * drift.landing_fraction**2 * drift.tolerance_ns
    target_ns = min(max(-drift.rate * hold_ns / 2, -furthest_ns), furthest_ns)
    return Setpoint(lead_ns, target_ns, target_ns)


def setpoint_to_meet(drift: Drift, lead_ns: float, ahead_ns: float) -> Setpoint | None:
    """Return the setpoint from which drift meets the grid in `ahead_ns`; None if no move is needed."""
    is_met = drift.tolerates(drift.error_after(ahead_ns))
    return None if is_met else Setpoint(lead_ns, -drift.rate * (ahead_ns - lead_ns))


def setpoint_for_burst(
    drift: Drift, lead_ns: float, ready_ns: float, scatter_ns: float, *, begins_ns: float, lasts_ns: float
) -> Setpoint | None:
    """Return the setpoint from which drift takes a stream to its grid in the middle of a burst, or before.

    None if the burst begins before `ready_ns`, while a long frame may still be under way. Also None if the
    error will be small, or no larger than `scatter_ns`, the scatter of moves.
    """
    # A recording may last for hours or end at any time: it begins within the tolerance.
    held_ns = LARGEST_LEAD * drift.tolerance_ns / max(abs(drift.rate), 1e-12)
    middle_ns = begins_ns + min(lasts_ns / 2, max(held_ns, SHORT_BURST_NS / 2))
    small_ns = max(BURST_FRACTION * drift.tolerance_ns, scatter_ns)
    if begins_ns < ready_ns or abs(drift.error_after(middle_ns)) <= small_ns:
        return None
    return Setpoint(lead_ns, -drift.rate * (middle_ns - lead_ns))
