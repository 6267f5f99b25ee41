"""A relay's map from its own clock to the root's, as messages carry it."""

from math import isfinite
from typing import Annotated

from msgspec import Meta, Struct

from capture_app.sync.clock.time_map import TimeMap

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
    drift_uncertainty: SkewError = 0.0

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
