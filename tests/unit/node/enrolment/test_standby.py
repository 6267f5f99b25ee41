"""Who leads in a leader's place: whom its nodes follow then, and whom it knows; over real UDP and TLS."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any

import pytest

from capture_app.common.address import Address
from capture_app.common.pairing_codes import Role
from capture_app.net.asking import ask
from capture_app.net.channel import connect
from capture_app.net.server import bind_port
from capture_app.node.leader import standby
from capture_app.node.leader.leader_node import LeaderNode
from capture_app.node.leader.leader_options import LeaderOptions
from capture_app.node.leader.standby import RankedLeader, lead_by_rank
from capture_app.protocol.messages import FromLeader, KeyAnswer, KeyRequest
from capture_app.sync.rig.burst_orders import BurstOrder
from capture_app.sync.wire.datagrams import Hello
from capture_app.trust.known_machines import CameraNames
from capture_app.trust.trust import Trust
from tests.cheap_rig import start_leader
from tests.facts import make_facts
from tests.unit.node.sealed_nodes import introduced, sealed_node
from tests.waiting import until

pytestmark = pytest.mark.virtual


def standby_of(tmp_path: Path, leader: Trust, name: str = "second") -> Trust:
    """The trust of a machine that was let in to lead in the place of a leader."""
    standby = introduced(tmp_path, leader, name, Role.STANDBY)
    own = leader.identity
    standby.known.add(own.pin, Role.STANDBY, name="first", certificate=own.certificate)
    return standby


class Led(asyncio.Queue[LeaderNode]):
    """What a standby leads with, and where that will be."""

    address: Address


def free_address() -> Address:
    bound = bind_port("127.0.0.1", 0)
    port = bound[0].getsockname()[1]
    for one in bound:
        one.close()
    return Address("127.0.0.1", port)


@asynccontextmanager
async def standing_by(
    tmp_path: Path, trust: Trust, leader: Address, *, is_better: bool = False
) -> AsyncIterator[Led]:
    """A standby of a leader, until the block ends; what it leads with comes by the queue."""
    led = Led()
    led.address = free_address()
    leaders = [led.address, leader] if is_better else [leader, led.address]

    async def lead(node: LeaderNode) -> None:
        led.put_nowait(node)
        await asyncio.Event().wait()

    def make_options() -> LeaderOptions:
        return LeaderOptions(sessions=tmp_path / "s2", host="127.0.0.1", port=led.address.port, trust=trust)

    task = asyncio.create_task(lead_by_rank(make_options, leaders, lead))
    try:
        yield led
    finally:
        task.cancel()
        with suppress(asyncio.CancelledError):
            await task


async def test_a_standby_leads_the_nodes_that_were_paired_with_the_leader(
    tmp_path: Path, trust: Trust
) -> None:
    async with await start_leader(tmp_path / "s1", trust=trust) as leader:
        machine, second = introduced(tmp_path, trust, "machine"), standby_of(tmp_path, trust)
        async with standing_by(tmp_path, second, leader.own_address) as led:
            await until(lambda: any(n.name.startswith("leader-") for n in leader.status().nodes))
            async with sealed_node(leader.own_address, machine) as node:
                await until(lambda: node.time.is_member)
                await until(lambda: machine.known.find(second.identity.pin) is not None)
                await until(lambda: second.known.find(machine.identity.pin) is not None, seconds=30.0)
                await until(lambda: "cam" in CameraNames(tmp_path / "second").owners, seconds=30.0)
            known = machine.known.find(second.identity.pin)
            assert known is not None
            assert (known.roles, known.vouched_by) == ((Role.LEADER,), trust.identity.pin)
            await leader.stop()
            new = await asyncio.wait_for(led.get(), 30.0)
            async with sealed_node(new.own_address, machine) as node:
                await until(lambda: node.time.is_member)
            # The name is still that machine's, and who was a stranger is one here, too.
            other = introduced(tmp_path, second, "other")
            async with sealed_node(new.own_address, other) as node:
                await until(lambda: "two machines are called cam" in node.time.why_joining)
            async with sealed_node(new.own_address, Trust(tmp_path / "stranger")) as node:
                await until(lambda: "does not know the leader" in node.time.why_joining)


async def test_a_burst_after_a_takeover_names_the_cameras_that_are_not_back(
    tmp_path: Path, trust: Trust, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[RankedLeader] = []

    class Noted(RankedLeader):
        def __init__(self, *arguments: Any) -> None:
            super().__init__(*arguments)
            made.append(self)

    monkeypatch.setattr(standby, "RankedLeader", Noted)
    monkeypatch.setattr(standby, "ASK_EVERY_S", 0.1)
    async with await start_leader(tmp_path / "s1", trust=trust) as leader:
        machine, second = introduced(tmp_path, trust, "machine"), standby_of(tmp_path, trust)
        async with standing_by(tmp_path, second, leader.own_address) as led:
            at = leader.own_address
            async with sealed_node(at, machine, "cam2", camera=make_facts()):
                await until(leader.engine.roster.cameras)
            async with (
                sealed_node(at, machine, "cam0", camera=make_facts()),
                sealed_node(at, machine, "cam1", camera=make_facts()),
            ):
                await until(lambda: [of.cameras for of in made] == [("cam0", "cam1")], seconds=30.0)
                await until(lambda: second.known.find(machine.identity.pin) is not None, seconds=30.0)
                await leader.stop()
            new = await asyncio.wait_for(led.get(), 30.0)
            async with sealed_node(new.own_address, machine, "cam1", camera=make_facts()):
                await until(lambda: new.engine.roster.cameras())
                # It has joined again, but has not answered the welcome yet.
                hello = Hello("cam0", 1, make_facts())
                new.engine.roster.admit(hello, ("127.0.0.1", 9), new.bursts.now_ns())
                burst = await new.bursts.order(BurstOrder(frames=1))
            assert burst.burst.clients == ("cam1",)
            assert burst.status.message == ("without cam0: it has not come back since the leader was lost")


async def test_a_node_goes_on_with_the_standby_when_the_leader_stops(tmp_path: Path, trust: Trust) -> None:
    async with await start_leader(tmp_path / "s1", trust=trust) as leader:
        machine, second = introduced(tmp_path, trust, "machine"), standby_of(tmp_path, trust)
        async with standing_by(tmp_path, second, leader.own_address) as led:
            await until(lambda: any(n.name.startswith("leader-") for n in leader.status().nodes))
            async with sealed_node(leader.own_address, machine, standbys=(led.address,)) as node:
                await until(lambda: node.time.is_member and node.time.timekeeper.time_is_known)
                await until(lambda: second.known.find(machine.identity.pin) is not None, seconds=30.0)
                before = node.time.timekeeper.path
                await leader.stop()
                new = await asyncio.wait_for(led.get(), 30.0)
                await until(lambda: node.time.is_member and node.time.timekeeper.path[0] == new.instance)
                assert before[0] == leader.instance
                assert node.time.timekeeper.time_is_known, "it has known the time all along"
                assert [n.name for n in new.status().nodes] == ["cam"]


async def test_a_camera_is_told_of_standbys_and_of_nobody_else(
    tmp_path: Path, leader: LeaderNode, trust: Trust
) -> None:
    camera, evil = introduced(tmp_path, trust, "camera"), introduced(tmp_path, trust, "evil")
    introduced(tmp_path, trust, "desk", Role.OPERATOR)
    second = standby_of(tmp_path, trust)
    request = KeyRequest(name="cam", instance=1)
    for machine in (camera, evil):
        async with await connect(leader.own_address, FromLeader, trust=machine) as channel:
            told = await ask(channel, request, KeyAnswer)
        assert [(one.pin, one.roles) for one in told.machines] == [(second.identity.pin, (Role.LEADER,))]
        assert told.names == {}


async def test_a_standby_that_leads_beside_the_leader_changes_nothing_there(
    tmp_path: Path, trust: Trust
) -> None:
    """Its program is changed: it serves at once, knows machines of its own, and owns all names."""
    machine, second = introduced(tmp_path, trust, "machine"), standby_of(tmp_path, trust)
    evil = introduced(tmp_path, second, "evil", Role.OPERATOR)
    trust.known.add(second.identity.pin, Role.STANDBY, certificate=second.identity.certificate)
    names = CameraNames(tmp_path / "second")
    names.owners["cam"] = second.identity.pin
    names.keep()
    known, place = trust.known.all(), free_address()
    options = LeaderOptions(sessions=tmp_path / "s1", host=place.host, port=place.port, trust=second)
    async with standing_by(tmp_path, trust, place, is_better=True) as led:
        leader = await asyncio.wait_for(led.get(), 30.0)
        async with sealed_node(leader.own_address, machine, standbys=(place,)) as node:
            await until(lambda: node.time.is_member and "cam" in leader.engine.roster.owners)
            async with await LeaderNode.start(options) as liar:
                await until(lambda: any(n.name.startswith("leader-") for n in liar.status().nodes))
                await asyncio.sleep(1.0)
                assert led.empty(), "it has led all the time"
                assert [n.name for n in leader.status().nodes if n.state != "lost"] == ["cam"]
                assert "cam" not in [n.name for n in liar.status().nodes]
    assert trust.known.find(evil.identity.pin) is None
    assert [(one.pin, one.roles) for one in trust.known.all()] == [(one.pin, one.roles) for one in known]
    assert CameraNames(Path(str(trust.folder))).owners["cam"] == machine.identity.pin


def test_a_name_that_has_an_owner_keeps_it_whatever_a_standby_says(tmp_path: Path, trust: Trust) -> None:
    second = standby_of(tmp_path, trust)
    trust.known.add(second.identity.pin, Role.STANDBY)
    names = CameraNames(tmp_path / "leader")
    names.owners["cam"] = "machine"
    names.keep()
    trust.take_trust_of(trust.peer_of(second.identity.pin), (), {"cam": "thief", "new": "other"})
    assert CameraNames(tmp_path / "leader").owners == {"cam": "machine", "new": "other"}


def test_with_a_machine_go_all_that_it_alone_vouched_for(tmp_path: Path, trust: Trust) -> None:
    second = standby_of(tmp_path, trust)
    evil = introduced(tmp_path, second, "evil", Role.OPERATOR)
    other = introduced(tmp_path, trust, "other")
    trust.take_trust_of(trust.peer_of(second.identity.pin), second.known.vouched_for(trust.identity.pin), {})
    assert trust.peer_of(evil.identity.pin).may(Role.OPERATOR)
    trust.known.remove("second")
    assert [one.pin for one in trust.known.all()] == [other.identity.pin]
