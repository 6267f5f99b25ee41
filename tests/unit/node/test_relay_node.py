"""A relay that has no leader yet, or no longer: what it says of itself, and what it leaves behind."""

import asyncio
import re
import socket
from pathlib import Path
from typing import Any

import pytest

from capture_app.common.address import Address
from capture_app.common.clock import SimulatedClock
from capture_app.common.errors import NetworkError
from capture_app.common.node_state import NodeState
from capture_app.net.channel import connect
from capture_app.net.server import bind_port
from capture_app.node import relay_node
from capture_app.node.endpoint import PortOptions
from capture_app.node.relay_node import RelayNode
from capture_app.protocol.log import Log
from capture_app.protocol.messages import BurstRequest, FromLeader, Refusal, StatusAnswer, StatusRequest
from capture_app.rig.rig_link import ask_status
from tests.cheap_rig import cheap_cameras, start_leader
from tests.unit.node.joining import joined
from tests.unit.node.thieves import ask
from tests.waiting import until

pytestmark = [pytest.mark.usefixtures("open_rig"), pytest.mark.virtual]


async def start_relay(*parents: Address, **options: Any) -> RelayNode:
    place = {"host": "127.0.0.1", "port": 0, "log": Log(), **options}
    return await RelayNode.start("hall", parents, PortOptions(**place))


async def test_a_relay_without_a_leader_answers_a_status_and_nothing_else(tmp_path: Path) -> None:
    async with await start_leader(tmp_path) as gone:
        nobody = gone.own_address
    async with await start_relay(nobody) as relay:
        rig = await ask_status(relay.own_address)
        assert (rig.relay, rig.is_open, rig.period_ns, rig.nodes) == ("hall", True, None, ())
        assert (rig.leader, rig.message) == (str(relay.address), "relay hall has not found a leader yet")
        assert rig.advice == rig.message
        async with await connect(relay.own_address, FromLeader) as channel:
            for _ in range(2):
                await channel.send(BurstRequest(frames=1))
                said = await channel.receive_header()
                assert isinstance(said, Refusal)
                assert said.what == "relay hall has not found a leader yet"
                assert said.hint == "on the relay's machine: capture-app doctor --leader HOST"


async def test_a_relay_that_lost_its_leader_says_since_when_and_how_accurate_it_is(tmp_path: Path) -> None:
    async with (
        await start_leader(tmp_path) as leader,
        await start_relay(leader.own_address, clock=SimulatedClock(3600 * 10**9)) as relay,
        cheap_cameras(["b", "a"], relay.own_address),
    ):
        await until(lambda: [n.state for n in relay.status().nodes] == [NodeState.READY] * 2, seconds=120.0)
        rig = relay.status()
        assert (rig.message, rig.advice[:15]) == ("", "2 cameras ready")
        assert [node.name for node in rig.nodes] == ["a", "b"]
        grid = leader.engine.grid
        assert grid is not None
        assert rig.period_ns == grid.period_ns
        assert abs(rig.now_ns - leader.bursts.now_ns()) < 10**9, "it is the leader's time"
        assert f"joined {leader.own_address}" in [line.text for line in relay.log.after(0)]
        assert "a joined" in [line.text for line in relay.log.after(0)]
        through = await ask_status(relay.own_address)
        assert (through.relay, through.leader) == (None, str(leader.address)), "its leader has answered"
        await leader.stop()
        await until(lambda: relay.status().message)
        await asyncio.sleep(7.0)
        rig = await ask_status(relay.own_address)
        assert re.fullmatch(
            r"relay hall lost its leader 7 s ago and is in holdover, accurate to [\d.]+ [µm]s", rig.message
        )
        assert rig.advice == rig.message
        assert [node.name for node in rig.nodes] == ["a", "b"]
        async with await connect(relay.own_address, FromLeader) as channel:
            page = await ask(channel, StatusRequest(after="a"))
        assert isinstance(page, StatusAnswer)
        assert [node.name for node in page.rig.nodes] == ["b"]


async def test_a_relay_that_is_stopped_leaves_nothing_running(tmp_path: Path) -> None:
    async with await start_leader(tmp_path) as leader:
        before = asyncio.all_tasks()
        async with await start_relay(leader.own_address), joined(leader.own_address, ("cam", 1)):
            await until(lambda: {"hall", "cam"} <= {node.name for node in leader.status().nodes})
        await until(lambda: asyncio.all_tasks() <= before)
        hall = leader.engine.roster.members["hall"]
        await until(lambda: hall.report.state is NodeState.LOST, seconds=1.0)


async def test_a_relay_between_two_kinds_of_addresses_is_refused_and_leaves_its_port_free(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async def resolve(address: Address) -> tuple[socket.AddressFamily, Address]:
        return socket.AF_INET6, address

    monkeypatch.setattr(relay_node, "resolve", resolve)
    bound = bind_port("127.0.0.1", 0)
    port = bound[0].getsockname()[1]
    for sock in bound:
        sock.close()
    with pytest.raises(NetworkError, match="and a leader's address mix IPv4 and IPv6") as refused:
        await start_relay(Address("::1", 9), port=port)
    again = bind_port("127.0.0.1", port)
    assert refused.value.hint == "listen on an address of the leader's kind with --host"
    for sock in again:
        sock.close()


async def test_a_relay_on_all_networks_names_the_further_addresses_at_which_nodes_may_join(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    nobody = Address("127.0.0.1", 9)
    async with await start_relay(nobody, host="0.0.0.0") as relay:
        hosts = [relay.address.host, "10.9.8.7"]
    monkeypatch.setattr(relay_node, "own_hosts", lambda _: hosts)
    async with await start_relay(nobody, host="0.0.0.0") as relay:
        assert relay.also == (Address("10.9.8.7", relay.address.port),)
    async with await start_relay(nobody) as relay:
        assert relay.also == ()
