"""Nodes that join a running leader, take its bursts and say nothing else."""

import asyncio
import socket
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress

from capture_app.net.address import Address
from capture_app.net.udp import client_socket
from capture_app.sync.wire.codec import decode, encode
from capture_app.sync.wire.messages import Hello, TimeReply, TimeRequest, Trigger, TriggerAck, Welcome
from tests.facts import make_facts

PATIENCE_S = 60.0
HELLO_EVERY_S = 0.3


@asynccontextmanager
async def joined(leader: Address, *nodes: tuple[str, int]) -> AsyncIterator[None]:
    """Nodes of these names and runs are members of a leader until the block ends."""
    present = [asyncio.Event() for _ in nodes]
    tasks = [
        asyncio.create_task(_stay(leader, *node, here)) for node, here in zip(nodes, present, strict=True)
    ]
    try:
        async with asyncio.timeout(PATIENCE_S):
            for here in present:
                await here.wait()
        yield
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


async def _stay(leader: Address, name: str, instance: int, here: asyncio.Event) -> None:
    loop = asyncio.get_running_loop()
    with client_socket(socket.AF_INET) as sock:
        while True:
            await loop.sock_sendto(sock, encode(Hello(name, instance, make_facts())), tuple(leader))
            with suppress(TimeoutError):
                async with asyncio.timeout(HELLO_EVERY_S):
                    while True:
                        message = decode(await loop.sock_recv(sock, 2048))
                        if isinstance(message, Welcome) and message.instance == instance:
                            alive = TimeRequest(message.client, 0, 0)
                            await loop.sock_sendto(sock, encode(alive), tuple(leader))
                        if isinstance(message, TimeReply):
                            here.set()
                        if isinstance(message, Trigger):
                            accepted = TriggerAck(message.client, message.leader, message.burst)
                            await loop.sock_sendto(sock, encode(accepted), tuple(leader))
