"""The frame grid of a rig, the instants at which all its cameras take their frames, and setpoints against it.

A setpoint says where a stream should be moved, so that its drift takes it through the grid when it counts.
"""

from dataclasses import dataclass

LARGEST_LEAD = 0.6
"""Most that a stream is moved past its grid in advance of its drift, as a share of the tolerance; a quarter
of that where half the tolerance is to be met."""
BURST_SHARE = 0.25
"""A burst whose error would exceed this share of the tolerance is corrected in advance."""


@dataclass(frozen=True, slots=True)
class FrameGrid:
    """The grid of instants all cameras are moved onto: anchor + k * period, in leader time."""

    anchor_leader_ns: int
    period_ns: int

    def index_of(self, leader_ns: int) -> int:
        """Number of the grid instant nearest to a leader time."""
        return (leader_ns - self.anchor_leader_ns + self.period_ns // 2) // self.period_ns

    def instant(self, index: int) -> int:
        """Leader time in ns of the grid instant of that number."""
        return self.anchor_leader_ns + index * self.period_ns

    def phase_error(self, leader_ns: int) -> int:
        """Distance in ns from the nearest grid instant, in [-period/2, period/2)."""
        return leader_ns - self.instant(self.index_of(leader_ns))


@dataclass(frozen=True, slots=True)
class Drift:
    """A stream's error now in ns, the rate by which it changes (ns per ns), and its period."""

    error_ns: float
    rate: float
    period_ns: float
    tolerance_ns: int
    grace_ns: float
    """Added to the tolerance, so that noise does not make a phase at its limit flicker in and out."""
    latency_frames: float = 0.0
    """Frames from a small step's command until it counts."""
    left_ns: float = 0.0
    """An error of up to so much is left as it is."""
    landing_share: float = 1.0
    """How near a move should bring the stream, as a share of the tolerance."""

    def error_after(self, ns: float) -> float:
        """Error in ns after so much time, if nothing moves the stream."""
        return self.error_ns + self.rate * ns

    def tolerates(self, error_ns: float) -> bool:
        """Whether an error can be left as it is."""
        return abs(error_ns) <= self.tolerance_ns + self.grace_ns


@dataclass(frozen=True, slots=True)
class Setpoint:
    """A wish for a move that takes effect `lead_ns` from now; times and errors in ns."""

    lead_ns: float
    wanted_ns: float
    """What the error should be then."""
    off_centre_ns: float = 0.0
    """How far the wish itself is off the grid, in advance of the drift."""


def setpoint_to_stay(drift: Drift, lead_ns: float, hold_ns: int) -> Setpoint:
    """Where a stream stays within its tolerance for longest: drift takes it through the middle."""
    furthest_ns = LARGEST_LEAD * drift.landing_share**2 * drift.tolerance_ns
    wanted_ns = min(max(-drift.rate * hold_ns / 2, -furthest_ns), furthest_ns)
    return Setpoint(lead_ns, wanted_ns, wanted_ns)


def setpoint_to_meet(drift: Drift, lead_ns: float, ahead_ns: float) -> Setpoint | None:
    """Where drift takes a stream to its grid at a moment to come; None if it will be there without a move."""
    if drift.tolerates(drift.error_after(ahead_ns)):
        return None
    return Setpoint(lead_ns, -drift.rate * (ahead_ns - lead_ns))


def setpoint_for_burst(
    drift: Drift, lead_ns: float, ready_ns: float, scatter_ns: float, *, begins_ns: float, lasts_ns: float
) -> Setpoint | None:
    """Where drift takes a stream to its grid in the middle of a burst.

    None if the burst begins before `ready_ns`, when no long frame is on its way any more, or if its
    error will be small, or no larger than `scatter_ns`, by which moves miss.
    """
    middle_ns = begins_ns + lasts_ns / 2
    small_ns = max(BURST_SHARE * drift.tolerance_ns, scatter_ns)
    if begins_ns < ready_ns or abs(drift.error_after(middle_ns)) <= small_ns:
        return None
    return Setpoint(lead_ns, -drift.rate * (middle_ns - lead_ns))
