"""Messages of the reference broadcast: beacons, which a radio cell receives at one instant, and answers."""

from typing import Annotated

from msgspec import Meta, Struct

MOST_ARRIVALS = 32
_OCTET = "(25[0-5]|2[0-4][0-9]|1[0-9][0-9]|[1-9]?[0-9])"
Host = Annotated[str, Meta(pattern=rf"^239\.{_OCTET}\.{_OCTET}\.{_OCTET}$")]
"""An IPv4 multicast address within an organization (RFC 2365), so that no client joins a global one."""
Port = Annotated[int, Meta(ge=1024, le=65535)]
Number = Annotated[int, Meta(ge=1, le=2**32 - 1)]
TimeNs = Annotated[int, Meta(ge=-(2**63), le=2**63 - 1)]
ErrorNs = Annotated[int, Meta(ge=0, le=10**18)]
Arrival = tuple[Number, TimeNs]
"""A beacon's number, and when it was received, in ns of the leader's time."""


class Group(Struct, frozen=True, array_like=True):
    """The IPv4 multicast group and the UDP port that a leader sends its beacons to."""

    host: Host
    port: Port


class Beacon(Struct, frozen=True, tag="beacon"):
    """A datagram that all receive at one instant; when it was sent does not matter."""

    leader: int
    """The run of the leader that sent it."""
    number: Number


class ArrivalReport(Struct, frozen=True, tag="arrivals"):
    """When a client received the newest beacons, by its own estimate of the leader's clock."""

    client: int
    uncertainty_ns: ErrorNs
    """95 % error of that estimate."""
    hard_bound_ns: ErrorNs
    """Largest error that the time messages allow."""
    arrivals: Annotated[tuple[Arrival, ...], Meta(max_length=MOST_ARRIVALS)]


class AgreedArrival(Struct, frozen=True, tag="agreed-arrival"):
    """When a client's clock should have received a beacon, to agree with all clients that received it."""

    client: int
    number: Number
    """The beacon's."""
    leader_ns: TimeNs
    uncertainty_ns: ErrorNs
    """95 % error against the leader's clock."""
    relative_uncertainty_ns: ErrorNs
    """95 % error against the other clients' clocks."""
