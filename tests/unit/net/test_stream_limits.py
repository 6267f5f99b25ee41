"""How long a port waits for its streams, how many it keeps, and who makes room, over loopback sockets."""

import asyncio
from contextlib import suppress
from typing import Any

from capture_app.common.address import Address
from capture_app.common.errors import NetworkError
from capture_app.net.channel import MAX_PAYLOAD_BYTES, Channel, StreamTimeouts, connect
from tests.unit.net.echoes import Ping, Pong, echo, received_from, serving

IMPATIENT = StreamTimeouts(first_s=0.3, idle_s=0.3, message_s=0.3, header_bytes=100)


async def is_closed(reader: asyncio.StreamReader) -> bool:
    try:
        async with asyncio.timeout(30):
            return await reader.read() == b""
    except ConnectionResetError:
        return True


async def test_who_keeps_a_stream_and_says_nothing_loses_it() -> None:
    async with serving(echo, stream_timeouts=IMPATIENT) as address:
        reader, writer = await asyncio.open_connection(*address)
        assert await is_closed(reader)
        writer.close()


async def test_who_takes_nothing_in_keeps_no_room() -> None:
    async def tell_for_ever(channel: Channel[Ping]) -> None:
        channel.is_known = True
        message = await channel.receive_header()
        while message == Ping(1):
            await channel.send(Pong(1), bytes(1 << 20))
        await channel.send(Pong(2))

    stream_timeouts = StreamTimeouts(first_s=60.0, message_s=0.3)
    async with (
        serving(tell_for_ever, stream_timeouts=stream_timeouts, max_streams=1) as address,
        await connect(address, Pong) as stuck,
    ):
        await stuck.send(Ping(1))
        assert await answer_to(address, Ping(2)) == (Pong(2), b"")


async def test_a_stream_that_is_closed_is_not_kept_for_what_nobody_takes_in() -> None:
    written = asyncio.Event()

    async def leave_unsent(channel: Channel[Ping]) -> None:
        channel.is_known = True
        if await channel.receive_header() == Ping(1):
            with suppress(TimeoutError):
                async with asyncio.timeout(0.1):
                    await channel.send(Pong(1), bytes(MAX_PAYLOAD_BYTES))
            written.set()
        else:
            await channel.send(Pong(2))

    stream_timeouts = StreamTimeouts(first_s=60.0, message_s=0.5)
    async with (
        serving(leave_unsent, stream_timeouts=stream_timeouts, max_streams=1) as address,
        await connect(address, Pong) as stuck,
    ):
        await stuck.send(Ping(1))
        await written.wait()
        assert await answer_to(address, Ping(2)) == (Pong(2), b"")


async def answer_to(address: Address, message: Ping) -> Any:
    """What a port says to a message, as soon as it has room for another stream."""
    async with asyncio.timeout(30):
        while True:
            try:
                async with await connect(address, Pong) as channel:
                    await channel.send(message)
                    if (answer := await received_from(channel)) is not None:
                        return answer
            except NetworkError:
                pass
            await asyncio.sleep(0.01)


async def test_idle_streams_make_room_and_those_that_speak_stay() -> None:
    async with (
        serving(watch_and_echo, stream_timeouts=StreamTimeouts(first_s=600.0), max_per_address=4) as address,
        await connect(address, Pong) as friend,
    ):
        await friend.send(Ping(1))
        assert await received_from(friend) == (Pong(1), b"")
        idle = [await asyncio.open_connection(*address) for _ in range(40)]
        for reader, _ in idle[:30]:
            assert await is_closed(reader)
        async with await connect(address, Pong) as another:
            await another.send(Ping(2))
            assert await received_from(another) == (Pong(2), b"")
        await friend.send(Ping(3))
        assert await received_from(friend) == (Pong(3), b"")
        for _, writer in idle:
            writer.close()


async def watch_and_echo(channel: Channel[Ping]) -> None:
    channel.allow_silence()
    await echo(channel)


async def trust_and_echo(channel: Channel[Ping]) -> None:
    channel.is_known = True
    await echo(channel)


async def test_streams_that_go_on_without_being_known_make_room_too() -> None:
    async with (
        serving(watch_and_echo, stream_timeouts=StreamTimeouts(first_s=600.0), max_streams=2) as address,
        await connect(address, Pong) as oldest,
        await connect(address, Pong) as other,
    ):
        for stranger in (oldest, other):
            await stranger.send(Ping(1))
            await received_from(stranger)
        async with await connect(address, Pong) as friend:
            await friend.send(Ping(2))
            assert await received_from(friend) == (Pong(2), b"")
            with suppress(NetworkError):
                assert await received_from(oldest) is None
            await other.send(Ping(3))
            assert await received_from(other) == (Pong(3), b"")


async def test_where_all_streams_are_in_use_a_further_one_is_refused() -> None:
    async with serving(trust_and_echo, max_streams=2) as address:
        async with await connect(address, Pong) as one, await connect(address, Pong) as two:
            for friend in (one, two):
                await friend.send(Ping(1))
                await received_from(friend)
            reader, writer = await asyncio.open_connection(*address)
            assert await is_closed(reader)
            writer.close()
            await two.send(Ping(2))
            assert await received_from(two) == (Pong(2), b"")
        assert await answer_to(address, Ping(5)) == (Pong(5), b"")
