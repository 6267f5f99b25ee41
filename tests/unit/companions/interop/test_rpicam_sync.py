"""What rpicam-apps hear of a leader and of a relay of it."""

import asyncio
import socket
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from capture_app.common.clock import HostClock, SimulatedClock
from capture_app.common.host_clock import host_ns
from capture_app.companions.interop.rpicam import PACKET, RpicamSync
from capture_app.node.followers import SharedGrid
from capture_app.node.leader.leader_node import LeaderNode
from capture_app.node.leader.leader_options import LeaderOptions
from capture_app.protocol.log import Log
from capture_app.sync.clock.time_map import TimeMap
from capture_app.sync.phase.frame_grid import FrameGrid
from tests.unit.node.joining import joined
from tests.waiting import TIMEOUT_S, time_limit

S = 1_000_000_000


class Rig:
    """A rig with this grid, that says when it was asked for it."""

    def __init__(self, grid: SharedGrid | None) -> None:
        self.grid = grid
        self.asked = asyncio.Event()

    def shared_grid(self) -> SharedGrid | None:
        self.asked.set()
        return self.grid


@pytest.fixture
def pi() -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        sock.setblocking(False)
        yield sock


async def heard(pi: socket.socket) -> tuple[int, int]:
    """Duration of a frame, and the wall clock's time of one, in ns, by the next packet."""
    async with time_limit("the next packet"):
        packet = await asyncio.get_running_loop().sock_recv(pi, 100)
    duration_us, _, frame_us, _, _ = PACKET.unpack(packet)
    return duration_us * 1000, frame_us * 1000


def wall_ns(at_host_ns: int) -> int:
    return at_host_ns + time.time_ns() - host_ns()


async def test_a_leader_sends_its_grid_in_the_wall_clock(
    pi: socket.socket, tmp_path: Path, open_rig: None
) -> None:
    sync = RpicamSync(["127.0.0.1"], port=pi.getsockname()[1])
    node = await LeaderNode.start(
        LeaderOptions(
            sessions=tmp_path,
            host="127.0.0.1",
            port=0,
            period_ns=33_328_000,
            grid_phase_ns=5,
            followers=[sync],
        )
    )
    async with node, joined(node.own_address, ("cam", 1)):
        duration_ns, frame_ns = await heard(pi)
        leader_ns = frame_ns - wall_ns(0)
        assert duration_ns == 33_328_000
        assert abs(FrameGrid(5, 33_328_000).phase_error(leader_ns)) < 100_000
        assert abs(leader_ns - host_ns()) < TIMEOUT_S * S


async def test_a_relay_sends_the_roots_grid_in_its_own_wall_clock(pi: socket.socket) -> None:
    grid = FrameGrid(90_000 * S, 33_328_000)
    clock = SimulatedClock(7200 * S, 20.0)
    now_ns = clock.now_ns()
    # The root is 50,000 s ahead of this node's clock.
    known = TimeMap(now_ns, 50_000 * S, 0.0, 1000.0, 1000.0, 0.0, 0.0, 300, 1000)
    sync = RpicamSync(["127.0.0.1"], port=pi.getsockname()[1])
    sync.start(clock, Log(), Rig((grid, known)).shared_grid)
    try:
        _, frame_ns = await heard(pi)
    finally:
        await sync.close()
    root_ns = known.leader_from_local(clock.local_from_true(frame_ns - wall_ns(0)))
    assert abs(grid.phase_error(root_ns)) < 100_000


async def test_without_a_grid_nothing_is_sent(pi: socket.socket) -> None:
    rig = Rig(None)
    sync = RpicamSync(["127.0.0.1"], port=pi.getsockname()[1])
    sync.start(HostClock(), Log(), rig.shared_grid)
    await rig.asked.wait()
    await sync.close()
    with pytest.raises(BlockingIOError):
        pi.recv(100)
