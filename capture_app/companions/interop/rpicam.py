"""Frame grid for rpicam-apps clients, sent in the packets of `rpicam-vid --sync server`.

Packet format, from raspberrypi/libcamera, src/ipa/rpi/controller/rpi/sync.h: 40 bytes, little-endian. Fields:
frame duration (32 bits, then 32 of padding), a frame's time in the kernel clock and in the wall clock, and
the clients' ready time in the kernel clock and in the wall clock; all in us. Clients use the duration and
both wall-clock times. They do not synchronize clocks: they take the sender's wall clock as their own.
"""

import asyncio
import contextlib
import socket
import struct
import time
from collections.abc import Callable, Sequence

from capture_app.common.address import own_hosts
from capture_app.common.clock import NodeClock
from capture_app.common.host_clock import host_ns
from capture_app.common.tasks import end
from capture_app.node.followers import Follower, SharedGrid
from capture_app.protocol.log import Log
from capture_app.sync.phase.frame_grid import FrameGrid

GROUP, PORT = "239.255.255.250", 10_000
PACKET = struct.Struct("<I4xQQQQ")
SEND_EVERY_NS = 500_000_000
"""Interval between packets. A client corrects one frame's duration per packet, some frames later, so a much
shorter interval does not help."""
READY_EVERY_NS = 10_000_000_000
"""Interval of ready times in leader time; clients start recording together at the first one after a
packet."""


def sync_packet(
    grid: FrameGrid, leader_ns: int, wall_from_leader: Callable[[int], int], *, shutter_ns: int = 0
) -> bytes:
    """Return the packet for a grid's latest instant; `wall_from_leader` maps to the receiver's wall clock.

    A Pi timestamps a frame at the end of its first row's exposure, `shutter_ns` after that row's start.
    """
    latest_ns = grid.instant(grid.index_of(leader_ns - grid.period_ns // 2))
    mark_ns = (leader_ns // READY_EVERY_NS + 1) * READY_EVERY_NS
    frame_us, ready_us = (
        round((wall_from_leader(instant_ns) + shutter_ns) / 1000)
        for instant_ns in (latest_ns, grid.instant(grid.index_of(mark_ns)))
    )
    return PACKET.pack(round(grid.period_ns / 1000), 0, frame_us, 0, ready_us)


class RpicamSync(Follower):
    """Sender of the rig's grid in this machine's wall clock, twice a second between `start` and `close`."""

    def __init__(
        self, hosts: Sequence[str], *, to_all: bool = False, shutter_ns: int = 0, port: int = PORT
    ) -> None:
        """Send to IPv4 hosts and, `to_all`, multicast on all interfaces; `shutter_ns`: the Pis' exposure."""
        self._hosts, self._to_all = tuple(hosts), to_all
        self._shutter_ns, self._port = shutter_ns, port
        self._task: asyncio.Task[None] | None = None

    def start(self, clock: NodeClock, event_log: Log, grid: Callable[[], SharedGrid | None]) -> None:
        """Start sending the rig's grid whenever one is known."""
        self._task = asyncio.create_task(self._run(clock, grid))

    async def close(self) -> None:
        """Stop sending. Calling it twice is harmless."""
        if self._task is not None:
            await end(self._task)

    async def _run(self, clock: NodeClock, grid: Callable[[], SharedGrid | None]) -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
            sock.setblocking(False)
            sock.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 1)
            while True:
                if (shared := grid()) is not None:
                    self._send(sock, clock, shared)
                await asyncio.sleep(SEND_EVERY_NS / 1e9)

    def _send(self, sock: socket.socket, clock: NodeClock, shared: SharedGrid) -> None:
        grid, time_map = shared
        wall_less_host_ns = time.time_ns() - host_ns()

        def wall_from_leader(leader_ns: int) -> int:
            local_ns = leader_ns if time_map is None else time_map.local_from_leader(leader_ns)
            return clock.true_from_local(local_ns) + wall_less_host_ns

        now_ns = clock.now_ns()
        leader_ns = now_ns if time_map is None else time_map.leader_from_local(now_ns)
        packet = sync_packet(grid, leader_ns, wall_from_leader, shutter_ns=self._shutter_ns)
        # A host or an interface may have disappeared, and receivers send no reply.
        for host in self._hosts:
            with contextlib.suppress(OSError):
                sock.sendto(packet, (host, self._port))
        for address in own_hosts(socket.AF_INET) if self._to_all else ():
            with contextlib.suppress(OSError):
                sock.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton(address))
                sock.sendto(packet, (GROUP, self._port))
