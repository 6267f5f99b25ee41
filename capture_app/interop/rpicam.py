"""Rpicam-apps that follow the rig's frame grid, by packets as `rpicam-vid --sync server` sends them.

A packet of 40 bytes, little-endian, by raspberrypi/libcamera, src/ipa/rpi/controller/rpi/sync.h: frame
duration (32 bits, and 32 of padding), time of a frame by the kernel's clock, the same by the wall clock, time
when clients are ready by the kernel's clock, the same by the wall clock; in us. Clients use the duration and
the wall clock's two. They synchronize no clocks: a packet is in the wall clock of those who receive it.
"""

import asyncio
import contextlib
import socket
import struct
import time
from collections.abc import Callable, Sequence

from capture_app.common.clock import NodeClock
from capture_app.common.interfaces import own_hosts
from capture_app.common.tasks import end
from capture_app.node.leader.followers import RigFollower, SharedGrid
from capture_app.protocol.news import Log
from capture_app.sync.phase.frame_grid import FrameGrid

GROUP, PORT = "239.255.255.250", 10_000
PACKET = struct.Struct("<I4xQQQQ")
SEND_EVERY_NS = 500_000_000
"""A client obeys each packet by one longer or shorter frame, some frames later: not much more often."""
READY_EVERY_NS = 10_000_000_000
"""Clients begin to record together at the first such mark of leader time after they have heard of it."""
HOPS = 1


def sync_packet(
    grid: FrameGrid, leader_ns: int, wall_from_leader: Callable[[int], int], *, shutter_ns: int = 0
) -> bytes:
    """Return the packet of the latest instant of a grid; `wall_from_leader` is for the receiver's wall clock.

    A Pi stamps a frame at the end of its first row's exposure, which is `shutter_ns` after its start.
    """
    latest_ns = grid.instant(grid.index_of(leader_ns - grid.period_ns // 2))
    mark_ns = (leader_ns // READY_EVERY_NS + 1) * READY_EVERY_NS
    frame_us, ready_us = (
        round((wall_from_leader(instant_ns) + shutter_ns) / 1000)
        for instant_ns in (latest_ns, grid.instant(grid.index_of(mark_ns)))
    )
    return PACKET.pack(round(grid.period_ns / 1000), 0, frame_us, 0, ready_us)


class RpicamSync(RigFollower):
    """Sends the grid twice a second while it is started, in the wall clock of this machine."""

    def __init__(
        self, hosts: Sequence[str], *, to_all: bool = False, shutter_ns: int = 0, port: int = PORT
    ) -> None:
        """Send to these IPv4 addresses, and `to_all` on all interfaces. `shutter_ns` is the Pis' exposure."""
        self._hosts, self._to_all = tuple(hosts), to_all
        self._shutter_ns, self._port = shutter_ns, port
        self._task: asyncio.Task[None] | None = None

    def start(self, clock: NodeClock, news: Log, grid: Callable[[], SharedGrid | None]) -> None:
        """Send the rig's grid from now on, where it has one."""
        self._task = asyncio.create_task(self._run(clock, grid))

    async def close(self) -> None:
        """Send no more. Calling it twice is harmless."""
        if self._task is not None:
            await end(self._task)

    async def _run(self, clock: NodeClock, grid: Callable[[], SharedGrid | None]) -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
            sock.setblocking(False)
            sock.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, HOPS)
            while True:
                if (shared := grid()) is not None:
                    self._send(sock, clock, shared)
                await asyncio.sleep(SEND_EVERY_NS / 1e9)

    def _send(self, sock: socket.socket, clock: NodeClock, shared: SharedGrid) -> None:
        wall_less_host_ns = time.time_ns() - time.monotonic_ns()

        def wall_from_leader(leader_ns: int) -> int:
            known = shared.time_map
            local_ns = leader_ns if known is None else known.local_from_leader(leader_ns)
            return clock.true_from_local(local_ns) + wall_less_host_ns

        now_ns = clock.now_ns()
        leader_ns = now_ns if shared.time_map is None else shared.time_map.leader_from_local(now_ns)
        packet = sync_packet(shared.grid, leader_ns, wall_from_leader, shutter_ns=self._shutter_ns)
        # A host or an interface may have gone meanwhile, and who listens tells nobody.
        for host in self._hosts:
            with contextlib.suppress(OSError):
                sock.sendto(packet, (host, self._port))
        for address in own_hosts(socket.AF_INET) if self._to_all else ():
            with contextlib.suppress(OSError):
                sock.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton(address))
                sock.sendto(packet, (GROUP, self._port))
