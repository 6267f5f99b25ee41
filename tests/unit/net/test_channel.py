"""Transfer streams over real loopback sockets, to a leader and on through relays."""

import asyncio
import struct

import msgspec
import pytest

from capture_app.common.address import Address
from capture_app.common.errors import NetworkError
from capture_app.net.channel import Channel, connect
from capture_app.net.server import bind_port
from tests.unit.net.echoes import PING, Ping, Pong, Serve, echo, received_from, serving


class Note(msgspec.Struct, frozen=True, tag="note"):
    text: str


async def test_a_message_and_its_payload_come_back() -> None:
    payload = bytes(range(256)) * 4096
    async with serving(echo) as address, await connect(address, Pong) as channel:
        await channel.send(Ping(7), payload)
        assert await received_from(channel) == (Pong(7), payload)
        await channel.send(Ping(8))
        assert await received_from(channel) == (Pong(8), b"")


@pytest.mark.parametrize(
    ("sent", "why"),
    [
        (b"GET / HTTP/1.1\r\n\r\n", "transfer protocol"),
        (struct.pack(">4sIQ", b"SSH1", len(PING), 9) + PING + b"...", "broke off"),
    ],
)
async def test_a_stranger_loses_its_own_stream_and_nobody_elses(sent: bytes, why: str) -> None:
    told: asyncio.Queue[str] = asyncio.Queue()

    async def serve(channel: Channel[Ping]) -> None:
        try:
            await echo(channel)
        except NetworkError as error:
            told.put_nowait(str(error))
            raise

    async with serving(serve) as address, await connect(address, Pong) as friend:
        reader, writer = await asyncio.open_connection(*address)
        writer.write(sent)
        writer.write_eof()
        assert why in await told.get()
        assert await reader.read() == b""
        writer.close()
        await writer.wait_closed()
        await friend.send(Ping(1))
        assert await received_from(friend) == (Pong(1), b"")


async def test_a_server_that_stops_ends_its_streams() -> None:
    async with serving(echo) as address:
        channel = await connect(address, Pong)
        await channel.send(Ping(1))
        await received_from(channel)
    assert await received_from(channel) is None
    await channel.close()
    with pytest.raises(NetworkError, match="no leader at"):
        await connect(address, Pong)


def test_one_number_serves_datagrams_and_streams() -> None:
    datagrams, listening = bind_port("127.0.0.1", 0)
    with datagrams, listening:
        assert datagrams.getsockname() == listening.getsockname()
        with pytest.raises(NetworkError, match="in use"):
            bind_port("127.0.0.1", listening.getsockname()[1])


def on_to(address: Address) -> Serve:
    async def serve(below: Channel[Ping]) -> None:
        async with await connect(address, Pong) as above:
            await below.relay(above)

    return serve


async def test_messages_pass_two_relays_unread_and_whole() -> None:
    payload = bytes(range(256)) * 4096
    async with serving(echo) as root, serving(on_to(root)) as upper, serving(on_to(upper)) as lower:
        async with await connect(lower, Pong) as channel:
            for number in range(3):
                await channel.send(Ping(number), payload)
                assert await received_from(channel) == (Pong(number), payload)
        # What is no message of ours passes too: the root is the one to judge it.
        reader, writer = await asyncio.open_connection(lower.host, lower.port)
        writer.write(b"GET / HTTP/1.1\r\n\r\n" + bytes(100))
        assert await reader.read() == b""
        writer.close()


async def test_what_was_sent_last_arrives_although_the_root_closes() -> None:
    async def answer_once(channel: Channel[Ping]) -> None:
        await received_from(channel)
        await channel.send(Pong(1), bytes(1 << 20))

    async with (
        serving(answer_once) as root,
        serving(on_to(root)) as relay,
        await connect(relay, Pong) as channel,
    ):
        await channel.send(Ping(1))
        assert await received_from(channel) == (Pong(1), bytes(1 << 20))
        assert await received_from(channel) is None


async def test_a_node_that_goes_away_is_noticed_at_the_root() -> None:
    gone = asyncio.Event()

    async def wait(channel: Channel[Ping]) -> None:
        await received_from(channel)
        assert await received_from(channel) is None
        gone.set()

    async with serving(wait) as root, serving(on_to(root)) as relay:
        async with await connect(relay, Pong) as channel:
            await channel.send(Ping(1))
        async with asyncio.timeout(30):
            await gone.wait()


async def test_no_text_of_a_stream_steers_a_terminal() -> None:
    async def say_again(channel: Channel[Note]) -> None:
        while (message := await channel.receive_header()) is not None:
            assert "\x1b" not in message.text
            assert "\u009b" not in message.text
            await channel.send(message)

    async with serving(say_again, Note) as address, await connect(address, Note) as channel:
        await channel.send(Note("\x1b[2J\u009b31m\r two\nlines \\u001b"))
        message = await channel.receive_header()
        assert message.text == "\ufffd[2J\ufffd31m\ufffd two\nlines \\u001b"
