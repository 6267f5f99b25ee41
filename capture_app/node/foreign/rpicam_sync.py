"""rpicam-apps that follow a rig's grid: packets as their own server sends them."""

import asyncio
import contextlib
import socket
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from capture_app.clock import NodeClock
from capture_app.net.interfaces import own_hosts
from capture_app.sync.clock.time_map import TimeMap
from capture_app.sync.foreign.rpicam_packets import GROUP, PORT, SEND_EVERY_NS, sync_packet
from capture_app.sync.phase.goal import Goal

HOPS = 1


@dataclass(frozen=True, slots=True)
class SharedGrid:
    """A rig's grid, as this machine knows it; without a map its clock is the rig's time."""

    goal: Goal
    time_map: TimeMap | None = None


class RpicamSync:
    """Sends the grid twice a second while it is started, in the wall clock of this machine."""

    def __init__(
        self, hosts: Sequence[str], *, to_all: bool = False, shutter_ns: int = 0, port: int = PORT
    ) -> None:
        """Send to these IPv4 addresses, and `to_all` on all interfaces. `shutter_ns` is the Pis' exposure."""
        self._hosts, self._to_all = tuple(hosts), to_all
        self._shutter_ns, self._port = shutter_ns, port
        self._task: asyncio.Task[None] | None = None

    def start(self, clock: NodeClock, grid: Callable[[], SharedGrid | None]) -> None:
        """Send what `grid` returns from now on, None for nothing."""
        self._task = asyncio.create_task(self._run(clock, grid))

    async def close(self) -> None:
        """Send no more. Calling it twice is harmless."""
        if self._task is not None:
            self._task.cancel()
            await asyncio.gather(self._task, return_exceptions=True)

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
        packet = sync_packet(shared.goal, leader_ns, wall_from_leader, shutter_ns=self._shutter_ns)
        # A host or an interface may have gone meanwhile, and who listens tells nobody.
        for host in self._hosts:
            with contextlib.suppress(OSError):
                sock.sendto(packet, (host, self._port))
        for address in own_hosts(socket.AF_INET) if self._to_all else ():
            with contextlib.suppress(OSError):
                sock.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton(address))
                sock.sendto(packet, (GROUP, self._port))
