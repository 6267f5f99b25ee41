"""Streams between machines that know each other, and those that do not; each machine is a folder here."""

import asyncio
import socket
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any, cast

import pytest

from capture_app.common.address import Address
from capture_app.common.errors import UnknownMachineError
from capture_app.common.pairing_codes import Role
from capture_app.net.channel import CHUNK_BYTES, Channel, StreamTimeouts, connect
from capture_app.trust.trust import Trust
from tests.unit.net.echoes import Ping, Pong, echo, received_from, serving


def introduce(machine: Trust, leader: Trust, role: Role = Role.CAMERA) -> None:
    """Let two machines know each other."""
    one, other = machine.identity, leader.identity
    machine.known.add(other.pin, Role.LEADER, name="leader", certificate=other.certificate)
    leader.known.add(one.pin, role, name="machine", certificate=one.certificate)


@pytest.fixture
def leader(tmp_path: Path) -> Trust:
    return Trust(tmp_path / "leader")


@pytest.fixture
def machine(tmp_path: Path) -> Trust:
    return Trust(tmp_path / "machine")


@asynccontextmanager
async def served(trust: Trust) -> AsyncIterator[tuple[Address, list[Channel[Any]]]]:
    seen: list[Channel[Any]] = []

    async def serve(channel: Channel[Any]) -> None:
        seen.append(channel)
        await echo(channel)

    async with serving(serve, trust=trust) as address:
        yield address, seen


async def ask(address: Address, trust: Trust) -> Any:
    async with await connect(address, Pong, trust=trust) as channel:
        await channel.send(Ping(7), b"picture")
        return await received_from(channel)


async def test_machines_that_know_each_other_talk_and_know_who_speaks(leader: Trust, machine: Trust) -> None:
    introduce(machine, leader, Role.OPERATOR)
    async with served(leader) as (address, seen):
        assert await ask(address, machine) == (Pong(7), b"picture")
        assert await ask(address, leader) == (Pong(7), b"picture"), "its own machine needs nothing"
    other, own = seen
    assert (other.who.pin, other.who.name) == (machine.identity.pin, "machine")
    assert other.who.may(Role.OPERATOR)
    assert not other.who.may(Role.CAMERA)
    assert all(own.who.may(role) for role in Role)


async def test_nothing_of_a_picture_is_seen_on_the_way(leader: Trust, machine: Trust) -> None:
    introduce(machine, leader)
    passed = bytearray()

    async def pass_on(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while data := await reader.read(65536):
            passed.extend(data)
            writer.write(data)
        writer.close()

    async with served(leader) as (address, _):

        async def relay(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            above = await asyncio.open_connection(*address)
            await asyncio.gather(pass_on(reader, above[1]), pass_on(above[0], writer))

        eavesdropper = await asyncio.start_server(relay, "127.0.0.1", 0)
        async with eavesdropper:
            port = eavesdropper.sockets[0].getsockname()[1]
            assert await ask(Address("127.0.0.1", port), machine) == (Pong(7), b"picture")
    assert len(passed) > 500
    assert b"picture" not in passed
    assert b"ping" not in passed


async def test_a_machine_that_the_leader_does_not_know_is_told_so(leader: Trust, machine: Trust) -> None:
    machine.known.add(leader.identity.pin, Role.LEADER)
    async with served(leader) as (address, seen):
        with pytest.raises(UnknownMachineError, match="does not know this machine"):
            await ask(address, machine)
        assert not seen, "nothing that it says reaches the leader"


async def test_a_leader_that_is_not_known_hears_nothing(leader: Trust, machine: Trust) -> None:
    leader.known.add(machine.identity.pin, Role.CAMERA, certificate=machine.identity.certificate)
    async with served(leader) as (address, _):
        with pytest.raises(UnknownMachineError, match="does not know the leader"):
            await connect(address, Pong, trust=machine)


async def test_a_camera_cannot_pose_as_the_leader_of_another(leader: Trust, machine: Trust) -> None:
    """A camera's pin is known to its leader as a camera, and to other cameras not at all."""
    introduce(machine, leader)
    async with served(machine) as (address, _):
        with pytest.raises(UnknownMachineError):
            await connect(address, Pong, trust=leader)


async def test_who_has_come_as_a_stranger_is_one(leader: Trust, machine: Trust) -> None:
    introduce(machine, leader)
    async with (
        served(leader) as (address, seen),
        await connect(address, Pong, trust=machine, as_unknown=True) as channel,
    ):
        await channel.send(Ping(1))
        assert await received_from(channel) == (Pong(1), b"")
    assert seen[0].who.is_unknown


async def test_who_is_removed_is_refused_from_the_next_stream_on(leader: Trust, machine: Trust) -> None:
    introduce(machine, leader)
    async with served(leader) as (address, _):
        assert await ask(address, machine) == (Pong(7), b"picture")
        leader.known.remove("machine")
        with pytest.raises(UnknownMachineError):
            await ask(address, machine)
        leader.known.add(machine.identity.pin, Role.CAMERA, certificate=machine.identity.certificate)
        assert await ask(address, machine) == (Pong(7), b"picture")


async def test_open_and_closed_rigs_say_what_keeps_them_apart(leader: Trust, machine: Trust) -> None:
    async with served(leader) as (address, _):
        assert await ask(address, Trust.open()) is None, "the stream is closed without a word"
    async with served(Trust.open()) as (address, seen):
        with pytest.raises(UnknownMachineError, match="which shows OPEN"):
            await ask(address, machine)
        assert await ask(address, Trust.open()) == (Pong(7), b"picture")
    assert seen[-1].who.may(Role.OPERATOR)


async def test_a_first_word_that_comes_at_once_is_not_lost(leader: Trust) -> None:
    """A ClientHello that lies there before its stream is accepted."""
    async with served(leader) as (address, _):
        for _ in range(5):
            answers = await asyncio.gather(*(ask(address, leader) for _ in range(20)))
            assert answers == [(Pong(7), b"picture")] * 20


async def test_half_a_greeting_holds_no_stream_for_long(
    leader: Trust, machine: Trust, caplog: pytest.LogCaptureFixture
) -> None:
    async with serving(echo, trust=leader, stream_timeouts=StreamTimeouts(first_s=0.1)) as address:
        for first in (b"", b"\x16\x03", b"GET / HTTP/1.0\r\n\r\n", bytes(5000)):
            with socket.create_connection(address) as stranger:
                stranger.sendall(first)
                with suppress(ConnectionResetError):
                    while await asyncio.to_thread(stranger.recv, 1000):
                        pass
        machine.known.add(leader.identity.pin, Role.LEADER)
        with pytest.raises(UnknownMachineError):
            await ask(address, machine)
        assert await ask(address, leader) == (Pong(7), b"picture")
    assert not caplog.records, "none of it is an error of the leader's"


async def test_only_known_machines_get_a_large_buffer(leader: Trust, machine: Trust) -> None:
    introduce(machine, leader)
    sizes: list[int] = []

    async def serve(channel: Channel[Any]) -> None:
        sizes.append(cast(Any, channel)._writer.transport._ssl_protocol.max_size)
        await echo(channel)

    async with serving(serve, trust=leader) as address:
        assert await ask(address, machine) == (Pong(7), b"picture")
        async with await connect(address, Pong, trust=machine, as_unknown=True) as channel:
            await channel.send(Ping(7))
            await received_from(channel)
    assert sizes == [CHUNK_BYTES, 1 << 15]
