"""Beacons through real nodes on the loopback interface: a leader's or a relay's, heard by its cameras."""

import asyncio
import contextlib
from collections.abc import AsyncIterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from capture_app.cameras.specs import open_camera
from capture_app.common.address import Address
from capture_app.common.clock import HostClock
from capture_app.net.multicast import BEACONS, BeaconSender, open_group_socket
from capture_app.node.camera.camera_node import CameraNode
from capture_app.node.camera.supervisor import NodeOptions
from capture_app.node.leader.leader import LeaderNode
from capture_app.node.leader.options import LeaderOptions
from capture_app.node.relay import RelayNode, RelayOptions
from capture_app.sync.rig.client import Client
from capture_app.sync.wire.codec import decode
from capture_app.sync.wire.messages import Beacon


class NearSender(BeaconSender):
    """Nodes of this machine, which a leader leaves out, count as others here."""

    def set_destinations(self, hosts: object) -> None:
        super().set_destinations(["127.0.0.2"])


BeaconArrivals = asyncio.Queue[tuple[Client[Any], Beacon]]


@pytest.fixture
def heard(monkeypatch: pytest.MonkeyPatch) -> BeaconArrivals:
    """What the clients hear."""
    sock = open_group_socket(BEACONS, "127.0.0.1")
    if sock is None:
        pytest.skip("no multicast on the loopback interface here")
    sock.close()
    notes: BeaconArrivals = asyncio.Queue()

    def hear(client: Client[Any], data: bytes, now_ns: int) -> None:
        beacon = decode(data)
        assert isinstance(beacon, Beacon)
        assert abs(HostClock().now_ns() - now_ns) < 10**10
        notes.put_nowait((client, beacon))

    monkeypatch.setattr(Client, "receive_broadcast", hear)
    return notes


@contextlib.asynccontextmanager
async def cameras(leader: Address) -> AsyncIterator[None]:
    nodes = [
        CameraNode(
            NodeOptions(
                name=f"cam{k}",
                open_camera=partial(open_camera, "sim:perfect", clock=HostClock(), name=f"cam{k}"),
                leaders=(leader,),
            )
        )
        for k in range(2)
    ]
    running = [asyncio.ensure_future(node.run()) for node in nodes]
    try:
        yield
    finally:
        for task in running:
            task.cancel()
        await asyncio.gather(*running, return_exceptions=True)


async def both_heard(heard: BeaconArrivals) -> set[int]:
    """Wait until two clients have heard something; return the runs that it came from."""
    clients: set[Client[Any]] = set()
    leaders: set[int] = set()
    async with asyncio.timeout(60):
        while len(clients) < 2:
            client, beacon = await heard.get()
            clients.add(client)
            leaders.add(beacon.leader)
    return leaders


async def test_the_cameras_of_a_leader_hear_its_beacons(heard: BeaconArrivals, tmp_path: Path) -> None:
    leader = await LeaderNode.start(
        LeaderOptions(sessions=tmp_path, host="127.0.0.1", port=0, beacons=NearSender(BEACONS))
    )
    async with leader, cameras(leader.address):
        assert leader.instance in await both_heard(heard)


async def test_the_cameras_of_a_relay_hear_the_relays(heard: BeaconArrivals, tmp_path: Path) -> None:
    leader = await LeaderNode.start(LeaderOptions(sessions=tmp_path, host="127.0.0.1", port=0))
    async with leader:
        relay = await RelayNode.start(
            RelayOptions(
                name="relay", parents=(leader.address,), host="127.0.0.1", port=0, beacons=NearSender(BEACONS)
            )
        )
        async with relay, cameras(relay.address):
            assert await both_heard(heard) == {relay.instance}


async def test_a_leader_that_is_not_asked_sends_none(heard: BeaconArrivals, tmp_path: Path) -> None:
    leader = await LeaderNode.start(LeaderOptions(sessions=tmp_path, host="127.0.0.1", port=0))
    async with leader, cameras(leader.address):
        async with asyncio.timeout(60):
            while len(leader.status().nodes) < 2:  # noqa: ASYNC110
                await asyncio.sleep(0.02)
        await asyncio.sleep(0.3)
    assert heard.empty()
