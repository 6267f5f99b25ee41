"""Who gets a key of a leader or a relay, and what becomes of those that have none, over real UDP and TLS."""

import asyncio
from pathlib import Path

import pytest

from capture_app.common.errors import DiskError
from capture_app.common.node_state import NodeState
from capture_app.common.pairing_codes import Role
from capture_app.net.channel import connect
from capture_app.node.endpoint import PortOptions
from capture_app.node.enrolment import Enrolment
from capture_app.node.leader.leader_node import LeaderNode
from capture_app.node.leader.leader_options import LeaderOptions
from capture_app.node.relay_node import RelayNode
from capture_app.protocol.log import Log
from capture_app.protocol.messages import FromLeader, KeyAnswer, KeyRequest, Refusal
from capture_app.sync.wire.codec import decode, encode
from capture_app.sync.wire.datagrams import Goodbye, Hello, JoinRefusal
from capture_app.trust.trust import Peer, Trust
from tests.cheap_rig import start_leader
from tests.facts import make_facts
from tests.waiting import until

from .sealed_nodes import hostile_socket, introduced, sealed_node

pytestmark = pytest.mark.virtual


def here(leader: LeaderNode | RelayNode) -> list[str]:
    return [node.name for node in leader.status().nodes if node.state is not NodeState.LOST]


async def test_a_known_machine_joins_and_keeps_the_time(
    tmp_path: Path, leader: LeaderNode, trust: Trust
) -> None:
    async with sealed_node(leader.own_address, introduced(tmp_path, trust, "machine")) as node:
        await until(lambda: node.time.time_map is not None)
        assert here(leader) == ["cam"]
        assert node.sealed.refusals.counts.total() == 0
    async with sealed_node(leader.own_address, trust, "own") as own:
        await until(lambda: own.time.is_member)


async def test_a_machine_that_is_not_known_or_no_camera_gets_no_key_and_is_told(
    tmp_path: Path, leader: LeaderNode, trust: Trust
) -> None:
    operator = introduced(tmp_path, trust, "operator", Role.OPERATOR)
    async with sealed_node(leader.own_address, operator) as node:
        await until(lambda: "not as camera" in node.time.why_joining)
    async with sealed_node(leader.own_address, Trust(tmp_path / "stranger")) as node:
        await until(lambda: "does not know the leader" in node.time.why_joining)
    assert here(leader) == []


async def test_datagrams_of_strangers_change_nothing_and_are_told(
    tmp_path: Path, leader: LeaderNode, trust: Trust
) -> None:
    machine = introduced(tmp_path, trust, "machine")
    async with sealed_node(leader.own_address, machine) as node:
        await until(lambda: node.time.is_member)
        assert node.time.number is not None
        with hostile_socket() as sock:
            hello = encode(Hello("stranger", 1, make_facts()))
            for message in (hello, encode(Goodbye(node.time.number))):
                sock.sendto(message, leader.own_address)
            async with asyncio.timeout(60):
                answer = await asyncio.get_running_loop().sock_recv(sock, 2048)
            assert isinstance(decode(answer), JoinRefusal)
            assert len(answer) <= len(hello)
            await until(lambda: any("refused" in line.text for line in leader.log.after(0)))
        assert here(leader) == ["cam"]
        await until(lambda: node.time.is_member)


async def test_a_leader_that_was_started_anew_gives_new_keys(tmp_path: Path, trust: Trust) -> None:
    machine = introduced(tmp_path, trust, "machine")
    first = await start_leader(tmp_path / "sessions", trust=trust)
    async with sealed_node(first.own_address, machine) as node:
        await until(lambda: node.time.is_member)
        await first.stop()
        port = first.own_address.port
        async with await LeaderNode.start(
            LeaderOptions(sessions=tmp_path, host="127.0.0.1", port=port, trust=trust)
        ) as second:
            await until(lambda: here(second) == ["cam"] and node.time.is_member)


async def test_a_machine_that_is_removed_loses_its_keys(
    tmp_path: Path, leader: LeaderNode, trust: Trust
) -> None:
    machine = introduced(tmp_path, trust, "machine")
    async with sealed_node(leader.own_address, machine) as node:
        await until(lambda: node.time.is_member)
        trust.known.remove("machine")
        await until(lambda: not node.time.is_member)
        await until(lambda: "does not know this machine" in node.time.why_joining)


async def test_who_is_removed_gets_no_key_over_a_stream_that_it_has_kept(
    tmp_path: Path, leader: LeaderNode, trust: Trust
) -> None:
    machine = introduced(tmp_path, trust, "machine")
    request = KeyRequest(name="cam", instance=1)
    async with await connect(leader.own_address, FromLeader, trust=machine) as channel:
        await channel.send(request)
        assert isinstance(await channel.receive_header(), KeyAnswer)
        trust.known.remove("machine")
        await channel.send(request)
        assert isinstance(await channel.receive_header(), Refusal)


async def test_below_a_relay_keys_are_the_relays(tmp_path: Path, leader: LeaderNode, trust: Trust) -> None:
    relays = introduced(tmp_path, trust, "relay", Role.RELAY)
    one = await RelayNode.start(
        "relay", (leader.own_address,), PortOptions(host="127.0.0.1", port=0, trust=relays)
    )
    async with one:
        camera = introduced(tmp_path, relays, "camera")
        async with sealed_node(one.address, camera, "below") as node:
            await until(lambda: node.time.time_map is not None)
            assert here(one) == ["below"]


async def test_a_camera_is_not_taken_for_a_relay(tmp_path: Path, leader: LeaderNode, trust: Trust) -> None:
    camera = introduced(tmp_path, trust, "camera")
    said: list[str] = []
    relay = await RelayNode.start(
        "relay",
        (leader.own_address,),
        PortOptions(host="127.0.0.1", port=0, trust=camera, log=Log(said.append)),
    )
    async with relay:
        await until(lambda: any("not as relay" in line for line in said))
    assert here(leader) == []


async def test_a_leader_that_cannot_keep_a_certificate_ends_no_node(
    tmp_path: Path, leader: LeaderNode, trust: Trust
) -> None:
    """Its pin was added there, and its request meets a disk that takes nothing."""
    machine = Trust(tmp_path / "machine")
    machine.known.add(trust.identity.pin, Role.LEADER)
    trust.known.add(machine.identity.pin, Role.CAMERA)
    lock = tmp_path / "leader" / "machines.lock"
    lock.unlink()
    lock.mkdir()
    async with sealed_node(leader.own_address, machine) as node:
        await until(lambda: "does not know this machine" in node.time.why_joining)
        await asyncio.sleep(0.5)
        lock.rmdir()
        await until(lambda: node.time.is_member)


async def test_a_leader_whose_disk_fails_for_a_moment_ends_no_node(
    tmp_path: Path, leader: LeaderNode, trust: Trust, monkeypatch: pytest.MonkeyPatch
) -> None:
    def hand_out(desk: Enrolment, who: Peer, request: KeyRequest) -> KeyAnswer:
        raise DiskError("its disk cannot be read")

    machine = introduced(tmp_path, trust, "machine")
    monkeypatch.setattr(Enrolment, "hand_out", hand_out)
    async with sealed_node(leader.own_address, machine) as node:
        await until(lambda: "its disk cannot be read" in node.time.why_joining)
        monkeypatch.undo()
        await until(lambda: node.time.is_member)
