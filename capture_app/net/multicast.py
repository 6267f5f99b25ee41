"""Beacons over IPv4 multicast: sent on every interface that clients are reached by, heard on the leader's.

Failures here are not reported: without beacons clients estimate the time from their own exchanges alone.
"""

import contextlib
import socket
from collections.abc import Callable, Iterable

from capture_app.common.clock import NodeClock
from capture_app.common.interfaces import source_address
from capture_app.common.node_state import NodeState
from capture_app.net.udp import Pump
from capture_app.sync.rig.leader import Leader
from capture_app.sync.wire.messages import Group
from capture_app.trust.sealed_engines import SealedLeader

BEACONS = Group("239.255.47.10", 47011)
"""One group for all rigs: a beacon says which leader sent it."""
HOPS = 1
"""Time to live: no router passes it on, so that all who hear it are on the same network."""

# Linux's number, which the socket module does not have: hear no groups that others on this host have joined.
_IP_MULTICAST_ALL = 49


class BeaconSender:
    """Sends to a group on all interfaces by which some hosts are reached."""

    def __init__(self, group: Group, *, fully: bool = True) -> None:
        """`fully`: as `LeaderConfig.agree_fully` says."""
        self.group, self.fully = group, fully
        self._hosts: frozenset[str] = frozenset()
        self._interfaces: tuple[str, ...] = ()
        self._socket: socket.socket | None = None

    def set_destinations(self, hosts: Iterable[str]) -> None:
        """Send on the interfaces that lead to these hosts from now on, those of this machine left out."""
        wanted = frozenset(hosts)
        if wanted == self._hosts:
            return
        self._hosts = wanted
        ways = {host: source_address(host) for host in wanted if ":" not in host}
        found = {address for host, address in ways.items() if address is not None and address != host}
        self._interfaces = tuple(sorted(found))
        if found and self._socket is None:
            self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            self._socket.setblocking(False)
            self._socket.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, HOPS)
            # Nodes on this machine would hear it before the others do.
            self._socket.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_LOOP, 0)

    def send(self, data: bytes) -> None:
        """Send a beacon on each interface; where one cannot send, it is left out."""
        if self._socket is None:
            return
        for address in self._interfaces:
            try:
                interface = socket.inet_aton(address)
                self._socket.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, interface)
                self._socket.sendto(data, (self.group.host, self.group.port))
            except OSError:
                # The interface may have another address now.
                self._hosts = frozenset()

    def close(self) -> None:
        """Send no more. Calling it twice is harmless."""
        self._interfaces = ()
        if self._socket is not None:
            self._socket.close()


class BeaconReceiver:
    """Listens to the group of the leader that was joined last; beacons go to `take` with their local time."""

    def __init__(
        self, take: Callable[[bytes, int], None], clock: NodeClock, after_turn: Callable[[], None]
    ) -> None:
        self._take = take
        self._clock = clock
        self._after_turn = after_turn
        self._pump: Pump | None = None

    def follow(self, group: Group | None, leader_host: str) -> None:
        """Listen to a group on the interface towards the leader, and no longer to what was before."""
        self.close()
        sock = None if group is None else open_group_socket(group, leader_host)
        if sock is not None:
            self._pump = Pump(self, self._clock, lambda: None)
            self._pump.start(sock)

    def receive_datagram(self, data: bytes, address: tuple[str, int], now_ns: int) -> None:
        """Take in one datagram, whoever sent it: only beacons of the leader that was joined count."""
        self._take(data, now_ns)
        self._after_turn()

    def datagrams_to_send(self, now_ns: int) -> list[tuple[bytes, tuple[str, int]]]:
        """Return no datagrams."""
        return []

    def next_timer(self) -> None:
        """Return None: there is no timer."""

    def handle_timer(self, now_ns: int) -> None:
        """Do nothing: there is no timer."""

    def close(self) -> None:
        """Listen no more. Calling it twice is harmless."""
        if self._pump is not None:
            self._pump.close()
            self._pump = None


def open_group_socket(group: Group, leader_host: str) -> socket.socket | None:
    """Return a socket that hears a group on the interface towards a host; None where that cannot be."""
    address = None if ":" in leader_host else source_address(leader_host)
    if address is None:
        return None
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        sock.setblocking(False)
        # Other nodes of this machine listen to the same.
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        with contextlib.suppress(OSError):
            sock.setsockopt(socket.IPPROTO_IP, _IP_MULTICAST_ALL, 0)
        sock.bind((group.host, group.port))
        membership = socket.inet_aton(group.host) + socket.inet_aton(address)
        sock.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, membership)
    except OSError:
        sock.close()
        return None
    return sock


def send_due_beacon(
    sender: BeaconSender | None, engine: Leader, now_ns: int, sealed: SealedLeader | None
) -> None:
    """Send the beacon that is due, if any, to where an engine's own nodes are, at `now_ns` of its time.

    `sealed` is what seals the engine's datagrams; None in a rig without seals.
    """
    beacon = engine.beacon_to_send()
    if beacon is None or sender is None:
        return
    own = [member for member in engine.roster.by_name() if member.via is None]
    sender.set_destinations(member.address[0] for member in own if member.report.state is not NodeState.LOST)
    sender.send(beacon if sealed is None else sealed.keys.seal_for_all(beacon))
