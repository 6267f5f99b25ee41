"""The shared goal of a rig: the grid of instants at which all its cameras take their frames."""

from dataclasses import dataclass

MIN_PERIOD_NS = 100_000
MAX_PERIOD_NS = 60_000_000_000
"""Frame periods that a rig can have: 10,000 fps to one a minute."""


@dataclass(frozen=True, slots=True)
class Goal:
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
