"""Time map from a node's own clock to the leader's, with its uncertainty and its hard bound."""

from dataclasses import dataclass, replace
from math import hypot

from capture_app.sync.clock.likely_line import SKEW

ROUNDING_NS = 2.0
"""Rounding of an offset and of a bound to whole ns, 1 each."""
SIGMAS_95 = 1.96
"""95 % of a normal distribution are within so many sigma."""
CRYSTALS_95 = SIGMAS_95 * SKEW
"""95 % bound of the skew between two crystals, however long they drift; dimensionless."""


@dataclass(frozen=True, slots=True)
class TimeMap:
    """Leader time as a line over local time: leader = local + offset + skew * (local - epoch).

    Away from the epoch the hard bound grows by `skew_bound` per ns, and the uncertainty (95 %) by
    `skew_uncertainty`, which itself grows by `drift_uncertainty` (in 1/ns) up to CRYSTALS_95.
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
    drift_uncertainty: float = 0.0

    def leader_from_local(self, local_ns: int) -> int:
        """Return the leader time in ns at a local time in ns."""
        return local_ns + self.offset_ns + round(self.skew * (local_ns - self.epoch_local_ns))

    def local_from_leader(self, leader_ns: int) -> int:
        """Return the local time in ns at a leader time in ns: the inverse of `leader_from_local` to 1 ns."""
        since_epoch = leader_ns - self.offset_ns - self.epoch_local_ns
        return self.epoch_local_ns + round(since_epoch - since_epoch * self.skew / (1.0 + self.skew))

    def uncertainty_at(self, local_ns: int) -> float:
        """Return the estimated 95 % error of `leader_from_local(local_ns)`, in ns."""
        elapsed_ns = abs(local_ns - self.epoch_local_ns)
        at_end = self.skew_uncertainty_after(elapsed_ns)
        growth = at_end * elapsed_ns
        if self.drift_uncertainty:
            # The skew's uncertainty grows to that of the end in a straight line.
            growth -= (at_end - self.skew_uncertainty) ** 2 / (2.0 * self.drift_uncertainty)
        return min(self.uncertainty_ns + growth, self.hard_bound_at(local_ns))

    def skew_uncertainty_after(self, elapsed_ns: float) -> float:
        """Return the 95 % error of the skew a time in ns from the epoch, which two crystals' skews limit."""
        return min(
            self.skew_uncertainty + self.drift_uncertainty * elapsed_ns,
            max(self.skew_uncertainty, CRYSTALS_95),
        )

    def hard_bound_at(self, local_ns: int) -> float:
        """Return the maximum error of `leader_from_local(local_ns)` in ns, link asymmetry included."""
        return self.hard_bound_ns + self.skew_bound * abs(local_ns - self.epoch_local_ns)

    def agrees_with(self, other: "TimeMap", local_ns: int) -> bool:
        """Return whether both may map to the same clock, by their hard bounds at a local time in ns."""
        apart_ns = self.leader_from_local(local_ns) - other.leader_from_local(local_ns)
        return abs(apart_ns) <= self.hard_bound_at(local_ns) + other.hard_bound_at(local_ns)

    def chained_to(self, upstream: "TimeMap") -> "TimeMap":
        """Return the map to the clock that a relay follows; `upstream` maps the relay's clock to that clock.

        Hard bounds add up; uncertainties add in quadrature, as the links are independent.
        """
        relay_ns = self.leader_from_local(self.epoch_local_ns)
        # The instant at which the upstream map is evaluated is itself uncertain by this map's bound.
        stretch = 1.0 + abs(upstream.skew) + upstream.skew_bound
        rate = 1.0 + abs(self.skew) + self.skew_bound
        upstream_skew = upstream.skew_uncertainty_after(max(0, relay_ns - upstream.epoch_local_ns))
        return replace(
            self,
            offset_ns=upstream.leader_from_local(relay_ns) - self.epoch_local_ns,
            skew=(1.0 + self.skew) * (1.0 + upstream.skew) - 1.0,
            uncertainty_ns=hypot(self.uncertainty_ns, upstream.uncertainty_at(relay_ns)),
            hard_bound_ns=self.hard_bound_ns * stretch + upstream.hard_bound_at(relay_ns) + ROUNDING_NS,
            skew_uncertainty=hypot(self.skew_uncertainty, upstream_skew),
            skew_bound=self.skew_bound * stretch + upstream.skew_bound * rate,
            drift_uncertainty=hypot(self.drift_uncertainty, upstream.drift_uncertainty),
        )
