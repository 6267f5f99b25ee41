"""The map from a node's own clock to the leader's, with its error bars; a relay's as messages carry it."""

from dataclasses import dataclass, replace
from math import hypot, isfinite, sqrt
from typing import Annotated

from msgspec import Meta, Struct

ROUNDING_NS = 2.0


@dataclass(frozen=True, slots=True)
class Correction:
    """What the reference broadcast added to a clock, and its 95 % error against other receivers; in ns."""

    reference_correction_ns: int
    relative_uncertainty_ns: float


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
    """What the reference broadcast has added at the epoch; None where it is not in use."""

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

    def corrected_by(self, correction: Correction, uncertainty_ns: float) -> "TimeMap":
        """Return the map with a correction added, which widens the hard bound, and another uncertainty."""
        hard_bound_ns = self.hard_bound_ns + abs(correction.reference_correction_ns)
        return replace(
            self,
            offset_ns=self.offset_ns + correction.reference_correction_ns,
            uncertainty_ns=min(uncertainty_ns, hard_bound_ns),
            hard_bound_ns=hard_bound_ns,
            correction=correction,
        )

    def chained_to(self, upstream: "TimeMap") -> "TimeMap":
        """Return the map to the clock that a relay follows: `upstream` maps the relay's clock to that one.

        Hard bounds add up; uncertainties add up in squares, as those of links that do not know each other.
        """
        relay_ns = self.leader_from_local(self.epoch_local_ns)
        # The upstream map is read at an instant that is itself known to the first bound only.
        stretch = 1.0 + abs(upstream.skew) + upstream.skew_bound
        pace = 1.0 + abs(self.skew) + self.skew_bound
        since_ns = max(0, relay_ns - upstream.epoch_local_ns)
        return TimeMap(
            epoch_local_ns=self.epoch_local_ns,
            offset_ns=upstream.leader_from_local(relay_ns) - self.epoch_local_ns,
            skew=(1.0 + self.skew) * (1.0 + upstream.skew) - 1.0,
            uncertainty_ns=hypot(self.uncertainty_ns, upstream.uncertainty_at(relay_ns)),
            hard_bound_ns=self.hard_bound_ns * stretch + upstream.hard_bound_at(relay_ns) + ROUNDING_NS,
            skew_uncertainty=hypot(self.skew_uncertainty, upstream.skew_uncertainty),
            skew_bound=self.skew_bound * stretch + upstream.skew_bound * pace,
            samples=self.samples,
            round_trip_ns=self.round_trip_ns,
            age_ns=self.age_ns,
            correction=self.correction,
            shared_uncertainty=self.shared_uncertainty
            + upstream.shared_uncertainty
            + upstream.skew_uncertainty**2 * since_ns,
        )


MAX_DEPTH = 8
"""Most clocks between a node's and the root's."""
Skew = Annotated[float, Meta(ge=-0.01, le=0.01)]
Error = Annotated[float, Meta(ge=0.0, le=1e18)]
SkewError = Annotated[float, Meta(ge=0.0, le=1.0)]
Offset = Annotated[int, Meta(ge=-(2**62), le=2**62)]


class UpstreamMap(Struct, frozen=True, array_like=True):
    """A relay's map from its own clock to the root's, as it goes over the wire; times in ns.

    A relay's time replies carry its own clock, which never jumps; its clients add this to what they find.
    `path` names the instances from the root to the relay, so that no relay follows itself.
    """

    path: Annotated[tuple[int, ...], Meta(min_length=1, max_length=MAX_DEPTH)]
    epoch_local_ns: int
    offset_ns: Offset
    skew: Skew
    uncertainty_ns: Error
    hard_bound_ns: Error
    skew_uncertainty: SkewError
    skew_bound: SkewError
    shared_uncertainty: Error = 0.0

    def time_map(self) -> TimeMap | None:
        """The map from the relay's clock to the root's; None where a value is not a number."""
        fields = {name: getattr(self, name) for name in _SHARED_FIELDS}
        if not all(isfinite(value) for value in fields.values() if isinstance(value, float)):
            return None
        return TimeMap(**fields, samples=0, round_trip_ns=0)


_SHARED_FIELDS = UpstreamMap.__struct_fields__[1:]
"""All but the path: fields that a time map has, too."""


def upstream_map(path: tuple[int, ...], time_map: TimeMap) -> UpstreamMap:
    """Return the message form of the time map of a relay with that path."""
    return UpstreamMap(path, *(getattr(time_map, name) for name in _SHARED_FIELDS))
