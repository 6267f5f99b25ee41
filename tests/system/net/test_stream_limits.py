"""How long a port waits for its streams, how many it keeps, and who makes room, over loopback sockets."""

import asyncio
import socket
import struct

from capture_app.net.channel import Channel, StreamTimeouts
from tests.unit.net.echoes import PING, Ping, Pong, serving

MESSAGE = struct.pack(">4sIQ", b"SSH1", len(PING), 0) + PING


async def test_a_slow_peer_gets_all_of_a_long_message() -> None:
    """It takes longer than the port waits for one that takes nothing in."""
    size = 24 << 20
    is_sent = False

    async def tell(channel: Channel[Ping]) -> None:
        nonlocal is_sent
        await channel.receive_header()
        await channel.send(Pong(1), bytes(size))
        is_sent = True

    async with serving(tell, stream_timeouts=StreamTimeouts(first_s=60.0, message_s=2.5)) as address:
        with socket.socket() as slow:
            slow.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 16)
            slow.connect(tuple(address))
            reader, writer = await asyncio.open_connection(sock=slow)
            writer.write(MESSAGE)
            got = len(await reader.readexactly(1 << 16))
            while piece := await reader.read(1 << 20):
                got += len(piece)
                await asyncio.sleep(len(piece) / size * 5.0)
            writer.close()
    assert got > size
    assert is_sent
