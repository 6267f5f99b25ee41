"""Streams that go on to another: all bytes, both ways, and the end of either is the end of both."""

import asyncio

from capture_app.net.address import Address
from capture_app.net.channel import Channel, connect

from .test_channel import Ping, Pong, Serve, echo, serving


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
                assert await channel.receive() == (Pong(number), payload)
        # What is no message of ours passes too: the root is the one to judge it.
        reader, writer = await asyncio.open_connection(lower.host, lower.port)
        writer.write(b"GET / HTTP/1.1\r\n\r\n" + bytes(100))
        assert await reader.read() == b""
        writer.close()


async def test_what_was_sent_last_arrives_although_the_root_closes() -> None:
    async def answer_once(channel: Channel[Ping]) -> None:
        await channel.receive()
        await channel.send(Pong(1), bytes(1 << 20))

    async with (
        serving(answer_once) as root,
        serving(on_to(root)) as relay,
        await connect(relay, Pong) as channel,
    ):
        await channel.send(Ping(1))
        assert await channel.receive() == (Pong(1), bytes(1 << 20))
        assert await channel.receive() is None


async def test_a_node_that_goes_away_is_noticed_at_the_root() -> None:
    gone = asyncio.Event()

    async def wait(channel: Channel[Ping]) -> None:
        await channel.receive()
        assert await channel.receive() is None
        gone.set()

    async with serving(wait) as root, serving(on_to(root)) as relay:
        async with await connect(relay, Pong) as channel:
            await channel.send(Ping(1))
        async with asyncio.timeout(30):
            await gone.wait()
