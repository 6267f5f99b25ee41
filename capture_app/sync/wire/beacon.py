"""Messages about beacons: numbered datagrams that all clients of one radio cell hear at one instant."""

from typing import Annotated

from msgspec import Meta, Struct

MOST_ARRIVALS = 32
_OCTET = "(25[0-5]|2[0-4][0-9]|1[0-9][0-9]|[1-9]?[0-9])"
Host = Annotated[str, Meta(pattern=rf"^239\.{_OCTET}\.{_OCTET}\.{_OCTET}$")]
"""IPv4 multicast of one organization (RFC 2365): nobody is made to join a group of the wide world."""
Port = Annotated[int, Meta(ge=1024, le=65535)]
Number = Annotated[int, Meta(ge=1, le=2**32 - 1)]
TimeNs = Annotated[int, Meta(ge=-(2**63), le=2**63 - 1)]
ErrorNs = Annotated[int, Meta(ge=0, le=10**18)]
Arrival = tuple[Number, TimeNs]
"""Number of a beacon, and when it was heard, in ns of the leader's time."""


class Group(Struct, frozen=True, array_like=True):
    """Where a leader's beacons can be heard: an IPv4 multicast group and its UDP port."""

    host: Host
    port: Port


class Beacon(Struct, frozen=True, tag="beacon"):
    """Heard by all at one instant; when it was sent does not matter. `leader` is the run that sent it."""

    leader: int
    number: Number


class ArrivalReport(Struct, frozen=True, tag="arrivals"):
    """When a client heard the newest beacons, by its own estimate of the leader's clock, with its errors."""

    client: int
    uncertainty_ns: ErrorNs
    hard_bound_ns: ErrorNs
    arrivals: Annotated[tuple[Arrival, ...], Meta(max_length=MOST_ARRIVALS)]


class AgreedArrival(Struct, frozen=True, tag="agreed-arrival"):
    """When that client should have thought it heard beacon `number`, to agree with all who heard it.

    Both errors are of 95 %: `uncertainty_ns` against the leader, `relative_uncertainty_ns` against the other
    clients.
    """

    client: int
    number: Number
    leader_ns: TimeNs
    uncertainty_ns: ErrorNs
    relative_uncertainty_ns: ErrorNs
