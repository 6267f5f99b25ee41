"""The map from a node's own clock to the leader's, with its error bars."""

from dataclasses import dataclass, replace
from math import hypot, sqrt

MIN_PERIOD_NS = 100_000
MAX_PERIOD_NS = 60_000_000_000
"""Frame periods that a rig can have: 10,000 fps to one a minute."""


ROUNDING_NS = 2.0


@dataclass(frozen=True, slots=True)
class Correction:
    """By how much a clock was moved, and its 95 % error against the others that hear the same; in ns."""

    moved_ns: int
    apart_ns: float


@dataclass(frozen=True, slots=True)
class TimeMap:
    """Leader time as a line over local time: leader = local + offset + skew * (local - epoch).

    `uncertainty_ns` (95 %) and `hard_bound_ns` hold at `epoch_local_ns`. Away from it the bound grows by
    `skew_bound` times the distance, and the square of the uncertainty by that of `skew_uncertainty` times
    the distance (both dimensionless, ns per ns), ahead by `shared_uncertainty` too.
    """

    epoch_local_ns: int
    offset_ns: int
    skew: float
    uncertainty_ns: float
    hard_bound_ns: float
    skew_uncertainty: float
    skew_bound: float
    samples: int
    round_trip_ns: int
    age_ns: int = 0
    """From the newest sample to the epoch."""
    shared_uncertainty: float = 0.0
    """Four times the covariance of the errors of offset and skew, in ns, where both have the same sign."""
    correction: Correction | None = None
    """What agreement with others has done to it, at the epoch; None where nothing was agreed."""

    def leader_from_local(self, local_ns: int) -> int:
        """Leader time in ns of a local time in ns."""
        return local_ns + self.offset_ns + round(self.skew * (local_ns - self.epoch_local_ns))

    def local_from_leader(self, leader_ns: int) -> int:
        """Local time in ns of a leader time in ns, the inverse of `leader_from_local` to 1 ns."""
        since_epoch = leader_ns - self.offset_ns - self.epoch_local_ns
        return self.epoch_local_ns + round(since_epoch - since_epoch * self.skew / (1.0 + self.skew))

    def uncertainty_at(self, local_ns: int) -> float:
        """Estimated 95 % error of `leader_from_local(local_ns)`, in ns."""
        ahead_ns = local_ns - self.epoch_local_ns
        shared = 2.0 * self.shared_uncertainty * max(0, ahead_ns)
        squared = self.uncertainty_ns**2 + shared + (self.skew_uncertainty * ahead_ns) ** 2
        return min(sqrt(squared), self.hard_bound_at(local_ns))

    def hard_bound_at(self, local_ns: int) -> float:
        """The most that `leader_from_local(local_ns)` can be wrong, in ns, link asymmetry included."""
        return self.hard_bound_ns + self.skew_bound * abs(local_ns - self.epoch_local_ns)

    def moved(self, correction: Correction, uncertainty_ns: float) -> "TimeMap":
        """Return the map moved by so much, with another uncertainty; what is proven is wider by the move."""
        hard_bound_ns = self.hard_bound_ns + abs(correction.moved_ns)
        return replace(
            self,
            offset_ns=self.offset_ns + correction.moved_ns,
            uncertainty_ns=min(uncertainty_ns, hard_bound_ns),
            hard_bound_ns=hard_bound_ns,
            correction=correction,
        )

    def then(self, onward: "TimeMap") -> "TimeMap":
        """Return the map to the leader's own leader: `onward` maps the leader's clock to that one's.

        Hard bounds add up; uncertainties add up in squares, as those of links that do not know each other.
        """
        relay_ns = self.leader_from_local(self.epoch_local_ns)
        # The onward map is read at an instant that is itself known to the first bound only.
        stretch = 1.0 + abs(onward.skew) + onward.skew_bound
        pace = 1.0 + abs(self.skew) + self.skew_bound
        since_ns = max(0, relay_ns - onward.epoch_local_ns)
        return TimeMap(
            epoch_local_ns=self.epoch_local_ns,
            offset_ns=onward.leader_from_local(relay_ns) - self.epoch_local_ns,
            skew=(1.0 + self.skew) * (1.0 + onward.skew) - 1.0,
            uncertainty_ns=hypot(self.uncertainty_ns, onward.uncertainty_at(relay_ns)),
            hard_bound_ns=self.hard_bound_ns * stretch + onward.hard_bound_at(relay_ns) + ROUNDING_NS,
            skew_uncertainty=hypot(self.skew_uncertainty, onward.skew_uncertainty),
            skew_bound=self.skew_bound * stretch + onward.skew_bound * pace,
            samples=self.samples,
            round_trip_ns=self.round_trip_ns,
            age_ns=self.age_ns,
            correction=self.correction,
            shared_uncertainty=self.shared_uncertainty
            + onward.shared_uncertainty
            + onward.skew_uncertainty**2 * since_ns,
        )


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
