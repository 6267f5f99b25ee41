"""Why a leader is not reached is said in a sentence with a remedy, whatever is in the way."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from capture_app.common.address import Address
from capture_app.common.errors import NetworkError
from capture_app.common.pairing_codes import Role
from capture_app.net.channel import connect
from capture_app.net.reachability import ProbeAnswer, find_obstacle, first_to_answer, obstacle
from capture_app.net.server import TransferServer, bind_port
from capture_app.sync.wire.codec import VERSION, version_mismatch
from capture_app.trust.trust import OPEN_VARIABLE, Trust
from tests.unit.net.ports import Answering, answering, closed_port

from .echoes import Ping, echo
from .machines import LEADER_HOST, NOBODY, two_machines

LEADER = Address("192.0.2.1", 47010)


@asynccontextmanager
async def a_leader(trust: Trust, *, first: int = 1) -> AsyncIterator[Address]:
    """What answers datagrams, and streams of those that it knows."""
    datagrams, listening = bind_port("127.0.0.1", 0)
    loop = asyncio.get_running_loop()
    transport, _ = await loop.create_datagram_endpoint(lambda: Answering(VERSION, first), sock=datagrams)
    server = TransferServer[Any](Ping, echo, trust=trust)
    await server.start(listening)
    yield Address("127.0.0.1", transport.get_extra_info("sockname")[1])
    await server.stop()
    transport.close()


@pytest.mark.parametrize("first", [1, 3])
async def test_nothing_is_in_the_way_to_a_leader_that_answers_even_if_not_at_once(first: int) -> None:
    async with a_leader(Trust.open(), first=first) as leader:
        assert await find_obstacle(leader, silence_s=60.0) is None


async def test_a_leader_whose_streams_are_shut_out_is_told_from_one_that_is_reached() -> None:
    async with answering() as leader:
        found = await find_obstacle(leader, silence_s=60.0)
    assert found is not None
    assert "accepts no TCP connection" in found.what
    assert f"ufw allow {leader.port}/tcp" in found.remedy


async def test_a_stream_that_does_not_show_who_it_is_is_said_and_ends_nothing(tmp_path: Path) -> None:
    async with a_leader(Trust.open()) as open_leader:
        found = await find_obstacle(open_leader, silence_s=60.0, trust=Trust(tmp_path))
    assert found is not None
    assert "does not prove its identity" in found.what


async def test_a_leader_of_another_version_is_told_from_none() -> None:
    async with answering(VERSION + 1) as leader:
        found = await find_obstacle(leader, silence_s=60.0)
    assert str(found) == version_mismatch(VERSION + 1)


async def test_a_leader_and_a_machine_that_do_not_know_each_other_are_to_be_paired(tmp_path: Path) -> None:
    leader, node = Trust(tmp_path / "leader"), Trust(tmp_path / "node")
    async with a_leader(leader) as address:
        neither = await find_obstacle(address, silence_s=60.0, trust=node)
        node.known.add(leader.identity.pin, Role.LEADER, name="leader")
        not_the_node = await find_obstacle(address, silence_s=60.0, trust=node)
        leader.known.add(node.identity.pin, Role.CAMERA, name="node", certificate=node.identity.certificate)
        nothing = await find_obstacle(address, silence_s=60.0, trust=node)
    assert neither is not None
    assert neither.what == f"this machine does not know the leader at {address}"
    assert not_the_node is not None
    assert not_the_node.what == f"the leader at {address} does not know this machine"
    assert f"capture-app trust pair {address}" in not_the_node.remedy
    assert nothing is None


async def test_a_machine_without_a_leader_is_told_at_once() -> None:
    found = await find_obstacle(closed_port(), silence_s=60.0)
    assert found is not None
    assert "127.0.0.1 is reachable, but no leader listens" in found.what
    assert "start it there with: capture-app" in found.remedy


async def test_a_name_that_no_machine_has_is_an_obstacle_too() -> None:
    found = await find_obstacle(Address("nobody.invalid", 47010))
    assert found is not None
    assert "cannot resolve host 'nobody.invalid'" in found.what


async def test_of_several_leaders_the_one_that_answers_is_found() -> None:
    async with answering() as leader:
        assert await first_to_answer([closed_port(), leader], silence_s=60.0) == leader


async def test_where_no_leader_answers_none_is_found() -> None:
    assert await first_to_answer([closed_port()], silence_s=0.05) is None
    assert await first_to_answer([], silence_s=0.05) is None


@pytest.mark.parametrize(
    ("by_udp", "by_tcp", "is_there", "what"),
    [
        (ProbeAnswer.SILENCE, ProbeAnswer.SILENCE, True, "a firewall drops"),
        (ProbeAnswer.SILENCE, ProbeAnswer.SILENCE, False, "no machine answers"),
        (ProbeAnswer.SILENCE, ProbeAnswer.SILENCE, None, "no reply"),
        (ProbeAnswer.SILENCE, ProbeAnswer.CAME, True, "does not answer UDP"),
        (ProbeAnswer.REFUSED, ProbeAnswer.CAME, True, "does not answer UDP"),
        (ProbeAnswer.CAME, ProbeAnswer.SILENCE, True, "accepts no TCP connection"),
        (ProbeAnswer.CAME, ProbeAnswer.REFUSED, None, "accepts no TCP connection"),
        (ProbeAnswer.REFUSED, ProbeAnswer.REFUSED, True, "no leader listens"),
        (ProbeAnswer.SILENCE, ProbeAnswer.REFUSED, None, "no leader listens"),
        (ProbeAnswer.FORBIDDEN, ProbeAnswer.SILENCE, None, "this machine's own firewall"),
        (ProbeAnswer.UNREACHABLE, ProbeAnswer.SILENCE, None, "no machine answers"),
        (ProbeAnswer.NO_ROUTE, ProbeAnswer.NO_ROUTE, None, "no route to"),
    ],
)
def test_what_is_in_the_way_is_told_by_what_comes_back(
    by_udp: ProbeAnswer, by_tcp: ProbeAnswer, is_there: bool | None, what: str
) -> None:
    found = obstacle(LEADER, by_udp, by_tcp, is_there=is_there)
    assert what in found.what
    assert found.remedy


def test_firewalls_and_wrong_addresses_are_told_apart_on_a_real_network() -> None:
    with two_machines() as (leader, node):
        listening = leader.start_python("-m", "tests.unit.net.listening", "47020", "47030")
        try:
            assert listening.stdout is not None
            assert listening.stdout.readline() == "listening\n"
            leader.add_firewall(
                "input", "udp dport 47020 drop", "meta l4proto {tcp, udp} th dport 47030 drop"
            )
            node.add_firewall("output", "udp dport 47050 drop")
            asked = [f"{LEADER_HOST}:{port}" for port in (47020, 47030, 47040, 47050)]
            said, _ = node.start_python(
                "-m", "tests.unit.net.asking", *asked, NOBODY, "10.99.0.1"
            ).communicate()
        finally:
            listening.kill()
            listening.communicate()
    no_datagrams, dropped, nobody_listens, own_firewall, no_machine, no_network = said.splitlines()
    assert (
        "10.77.0.1:47020 accepts TCP connections, but does not answer UDP: allow UDP through" in no_datagrams
    )
    assert "10.77.0.1 is reachable, but a firewall drops packets to its port 47030" in dropped
    assert "10.77.0.1 is reachable, but no leader listens on its port 47040" in nobody_listens
    assert "this machine's own firewall blocks all traffic to 10.77.0.1:47050" in own_firewall
    assert "no machine answers at 10.77.0.99" in no_machine
    assert "this machine has no route to 10.99.0.1" in no_network


async def test_a_port_that_is_open_and_silent_is_told_from_a_firewall(tmp_path: Path) -> None:
    """As of a leader that is stopped, or hangs: its kernel takes streams and keeps datagrams."""
    node = Trust(tmp_path)
    datagrams, listening = bind_port("127.0.0.1", 0)
    address = Address("127.0.0.1", listening.getsockname()[1])
    try:
        found = await find_obstacle(address, silence_s=1.5, trust=node)
        with pytest.raises(NetworkError, match="is open, but nothing there answers") as error:
            await connect(address, Ping, trust=node, timeout_s=0.5)
    finally:
        datagrams.close()
        listening.close()
    assert found is not None
    assert found.what == f"the port of {address} is open, but nothing there answers"
    assert "firewall" not in found.remedy + error.value.hint


async def test_a_handshake_that_is_cut_is_no_reason_to_ask_nobody(tmp_path: Path) -> None:
    """Whoever is on the way can cut it, and would be let in by that."""
    node = Trust(tmp_path)
    for paired in (False, True):
        if paired:
            node.known.add(Trust(tmp_path / "leader").identity.pin, Role.LEADER, name="leader")
        async with a_leader(Trust.open()) as address:
            with pytest.raises(NetworkError) as error:
                await connect(address, Ping, trust=node)
        assert OPEN_VARIABLE not in str(error.value) + error.value.hint
        assert ("no longer paired with this machine" in str(error.value)) is paired
