"""What a relay that speaks for a machine has looked at is all that it may say: over real UDP and TLS."""

import asyncio
import random
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any

import pytest

from capture_app.common.address import Address
from capture_app.common.errors import NetworkError
from capture_app.common.pairing_codes import Role
from capture_app.net.channel import Channel, connect
from capture_app.node.endpoint import PortOptions
from capture_app.node.leader.leader_node import LeaderNode
from capture_app.node.relay_node import RelayNode
from capture_app.protocol.messages import (
    FromLeader,
    KeyRequest,
    NodeStream,
    Refusal,
    ReportAck,
    SpoolSpace,
    StatusRequest,
)
from capture_app.protocol.orders import InvitePhone, StopRig
from capture_app.protocol.pairing_messages import EnrolRequest, Invite, SpeaksFor
from capture_app.sync.rig import roster as roster_module
from capture_app.sync.rig.roster import Roster
from capture_app.sync.wire.datagrams import Hello, Principal
from capture_app.trust.trust import Trust
from tests.cheap_rig import start_leader
from tests.facts import make_facts
from tests.unit.node.joining import joined
from tests.unit.node.sealed_nodes import introduced
from tests.waiting import until

pytestmark = pytest.mark.virtual

RUNS = {"cam0": 1111, "cam1": 2222}
"""The names and runs of two cameras: anybody in the network can read them in their datagrams."""


@asynccontextmanager
async def relays(folder: Path, depth: int) -> AsyncIterator[tuple[LeaderNode, RelayNode, Trust]]:
    """A leader and so many relays below each other; the last one, and its trust."""
    trust = Trust(folder / "leader")
    async with await start_leader(folder / "sessions", trust=trust) as leader:
        own = introduced(folder, trust, "relay-1", Role.RELAY)
        async with await relay("relay-1", leader.own_address, own) as first:
            if depth == 1:
                yield leader, first, own
                return
            below = introduced(folder, own, "relay-2", Role.RELAY)
            async with await relay("relay-2", first.address, below) as second:
                yield leader, second, below


async def relay(name: str, parent: Address, trust: Trust) -> RelayNode:
    return await RelayNode.start(name, (parent,), PortOptions(host="127.0.0.1", port=0, trust=trust))


async def ask(channel: Channel[Any], message: Any) -> Any:
    await channel.send(message)
    return await channel.receive_header()


@pytest.mark.parametrize("depth", [1, 2])
async def test_a_camera_below_a_relay_speaks_for_no_other_of_that_relay(tmp_path: Path, depth: int) -> None:
    """Neither at once nor later on a stream which its relay passes on unread."""
    async with relays(tmp_path, depth) as (leader, near, trust):
        machines = {name: introduced(tmp_path, trust, name) for name in RUNS}
        nodes = [joined(near.address, (name, RUNS[name]), trust=machines[name]) for name in RUNS]
        async with nodes[0], nodes[1]:
            await until(lambda: {*RUNS} <= {node.name for node in leader.status().nodes})
            for first in (
                None,
                NodeStream(camera="cam1", instance=RUNS["cam1"]),
                SpoolSpace(camera="cam1", free_bytes=1, spool="x"),
            ):
                for shows in (False, True):
                    where = near.address
                    async with await connect(where, FromLeader, trust=machines["cam1"]) as channel:
                        if first is not None:
                            assert await ask(channel, first) is not None
                        said = await ask(
                            channel, NodeStream(camera="cam0", instance=RUNS["cam0"], shows=shows)
                        )
                        assert isinstance(said, Refusal), (first, shows)
            async with await connect(near.address, FromLeader, trust=machines["cam0"]) as channel:
                own = NodeStream(camera="cam0", instance=RUNS["cam0"])
                assert isinstance(await ask(channel, own), ReportAck)


async def test_streams_to_a_leader_that_the_relay_has_lost_are_broken_off(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A leader that lost its power closes none; a node waits for no answer of its own."""
    async with relays(tmp_path, 1) as (leader, near, trust):
        camera = introduced(tmp_path, trust, "cam0")
        async with joined(near.address, ("cam0", RUNS["cam0"]), trust=camera):
            await until(lambda: "cam0" in [node.name for node in leader.status().nodes])
            async with await connect(near.address, FromLeader, trust=camera) as channel:
                own = NodeStream(camera="cam0", instance=RUNS["cam0"])
                assert isinstance(await ask(channel, own), ReportAck)
                monkeypatch.setattr(leader.engine, "datagrams_to_send", lambda _: ())
                async with asyncio.timeout(20):
                    assert await channel.receive_header() is None


async def test_a_relay_takes_no_name_of_a_camera_that_is_paired_with_the_leader(tmp_path: Path) -> None:
    """The pin of that camera is no secret: a standby is given all of them."""
    async with relays(tmp_path, 1) as (leader, near, trust):
        direct = introduced(tmp_path, leader.options.trust, "direct")
        below = introduced(tmp_path, trust, "below")
        trust.known.add(direct.identity.pin, Role.CAMERA, certificate=direct.identity.certificate)
        near_side = Trust(tmp_path / "direct")
        near_side.known.add(
            trust.identity.pin, Role.LEADER, name="relay-1", certificate=trust.identity.certificate
        )
        async with joined(near.address, ("cam0", 1), trust=below):
            await until(lambda: "cam0" in [node.name for node in leader.status().nodes])
            joining = asyncio.create_task(join(near.address, ("cam1", 2), near_side))
            await until(lambda: any("no relay may speak" in line.text for line in leader.log.after(0)))
            assert "cam1" not in [node.name for node in leader.status().nodes]
            joining.cancel()


async def join(address: Address, node: tuple[str, int], trust: Trust) -> None:
    async with joined(address, node, trust=trust):
        await asyncio.Event().wait()


@pytest.mark.parametrize(
    "message",
    [Invite(role=Role.STANDBY), StopRig(), InvitePhone(), KeyRequest(name="x", instance=1)],
    ids=repr,
)
async def test_a_relay_neither_invites_nor_stops_nor_asks_for_keys_for_others(
    tmp_path: Path, message: Any
) -> None:
    async with relays(tmp_path, 1) as (leader, _, trust):
        async with await connect(leader.own_address, FromLeader, trust=trust) as channel:
            await channel.send(SpeaksFor(pin="", name="x", roles=tuple(Role)))
            refusal = await ask(channel, message)
            assert isinstance(refusal, Refusal)
            assert "a relay may not send this" in refusal.what
        assert not leader.service.stop_requested.is_set()


async def test_a_stranger_at_a_relay_is_answered_with_a_sentence_and_nothing_else(tmp_path: Path) -> None:
    stranger = Trust(tmp_path / "stranger")
    requests = EnrolRequest(certificate=stranger.identity.certificate), StatusRequest(), Invite()
    async with relays(tmp_path, 1) as (_, near, trust):
        known = trust.known.all()
        for message in requests:
            where = connect(near.address, FromLeader, trust=stranger, as_unknown=True)
            async with await where as channel:
                assert isinstance(await ask(channel, message), Refusal)
                with suppress(NetworkError):
                    assert await ask(channel, message) is None, "it has another guess"
        assert trust.known.all() == known


async def test_no_relay_speaks_for_the_leaders_own_machine(tmp_path: Path) -> None:
    """Its pin is announced by mDNS; only a relay of the same machine may introduce its cameras."""
    async with relays(tmp_path, 1) as (leader, near, trust):
        own = leader.options.trust
        trust.known.add(own.identity.pin, Role.CAMERA, certificate=own.identity.certificate)
        own.known.add(trust.identity.pin, Role.LEADER, certificate=trust.identity.certificate)
        joining = asyncio.create_task(join(near.address, ("cam0", 1), own))
        await until(lambda: any("is the leader's own" in line.text for line in leader.log.after(0)))
        joining.cancel()
    roster = Roster(random.Random(1))
    roster.own_pin = "own"
    hello = Hello("cam0", 1, make_facts(), via="relay", pin="own")
    assert not roster.refusal_below(Principal("relay", 1, "own", is_relay=True), hello)


async def test_a_relay_introduces_so_many_nodes_and_no_more(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(roster_module, "MAX_BELOW_RELAY", 2)
    roster, relay = Roster(random.Random(1)), Principal("relay", 1, "pin", is_relay=True)
    for number in range(2):
        hello = Hello(f"cam{number}", number, make_facts(), via="relay", pin=f"{number}")
        assert not roster.refusal_below(relay, hello)
        roster.admit(hello, ("10.0.0.1", 1), 0, relay)
    third = Hello("cam2", 2, make_facts(), via="relay")
    assert "2 nodes" in roster.refusal_below(relay, third)
    assert not roster.refusal_below(Principal("other", 1, "other", is_relay=True), third)
