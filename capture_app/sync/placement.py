"""The moment at which a rig's frames will lie closest together, from each camera's phase and drift."""

from collections.abc import Sequence
from dataclasses import dataclass

from capture_app.sync.timebase import Goal

MOST_CANDIDATES = 200
MOST_PPM = 1000.0


@dataclass(frozen=True, slots=True)
class Forecast:
    """What is known of a camera's frames: the leader time of one in ns, and their drift from the grid."""

    frame_leader_ns: int
    drift_ppm: float


def spread_ns(goal: Goal, forecasts: Sequence[Forecast], at_leader_ns: int) -> float:
    """Predicted time in ns from the earliest frame to the latest of those nearest to a leader time."""
    errors = [
        goal.phase_error(f.frame_leader_ns) + f.drift_ppm * 1e-6 * (at_leader_ns - f.frame_leader_ns)
        for f in forecasts
        if abs(f.drift_ppm) < MOST_PPM
    ]
    return max(errors) - min(errors) if errors else 0.0


def calmest(goal: Goal, forecasts: Sequence[Forecast], from_leader_ns: int, within_ns: int) -> int:
    """The instant of the grid with the least predicted spread, from a leader time to `within_ns` after it.

    The earliest of equals; at most MOST_CANDIDATES, evenly spread, are looked at.
    """
    first, last = goal.index_of(from_leader_ns), goal.index_of(from_leader_ns + max(0, within_ns))
    step = max(1, -(-(last - first) // MOST_CANDIDATES))
    instants = [goal.instant(index) for index in range(first, last + 1, step)]
    return min(instants, key=lambda instant_ns: spread_ns(goal, forecasts, instant_ns))
