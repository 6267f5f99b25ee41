"""Nodes that join a running leader, take its bursts and say nothing else."""

import asyncio
import socket
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress

from capture_app.common.address import Address
from capture_app.common.node_state import NodeState
from capture_app.net.channel import connect
from capture_app.net.udp import client_socket
from capture_app.protocol.messages import FromLeader, KeyAnswer, KeyRequest
from capture_app.sync.wire.codec import decode, encode
from capture_app.sync.wire.datagrams import (
    ControlMessage,
    Heartbeat,
    Hello,
    Report,
    TimeReply,
    TimeRequest,
    Trigger,
    TriggerAck,
    Welcome,
)
from capture_app.trust.datagram_keys import LeaderKeys
from capture_app.trust.trust import Trust
from tests.facts import make_facts
from tests.waiting import time_limit

HELLO_EVERY_S = 0.3


@asynccontextmanager
async def joined(leader: Address, *nodes: tuple[str, int], trust: Trust | None = None) -> AsyncIterator[None]:
    """Nodes of these names and runs are members of a leader until the block ends.

    With `trust` they are of a machine that the leader knows, else the rig is an open one.
    """
    present = [asyncio.Event() for _ in nodes]
    tasks = [
        asyncio.create_task(_stay(leader, *node, here, trust))
        for node, here in zip(nodes, present, strict=True)
    ]
    try:
        async with time_limit(f"{nodes} to have joined"):
            for here in present:
                await here.wait()
        yield
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


async def _stay(leader: Address, name: str, instance: int, here: asyncio.Event, trust: Trust | None) -> None:
    loop = asyncio.get_running_loop()
    keys = LeaderKeys()
    if trust is not None:
        async with await connect(leader, FromLeader, trust=trust) as channel:
            await channel.send(KeyRequest(name=name, instance=instance))
            answer = await channel.receive_header()
        assert isinstance(answer, KeyAnswer)
        keys.hold(leader, answer.grant)

    async def send(message: ControlMessage | TimeRequest) -> None:
        data = encode(message)
        sealed = data if trust is None else keys.seal(data, leader)
        assert sealed is not None
        await loop.sock_sendto(sock, sealed, tuple(leader))

    with client_socket(socket.AF_INET) as sock:
        while True:
            await send(Hello(name, instance, make_facts()))
            with suppress(TimeoutError):
                async with asyncio.timeout(HELLO_EVERY_S):
                    while True:
                        data = await loop.sock_recv(sock, 2048)
                        message = decode(data if trust is None else keys.open(data, leader))
                        if isinstance(message, Welcome) and message.instance == instance:
                            await send(TimeRequest(message.client, 0, 0))
                            await send(Heartbeat(message.client, Report(state=NodeState.SYNCING)))
                        if isinstance(message, TimeReply):
                            here.set()
                        if isinstance(message, Trigger):
                            await send(TriggerAck(message.client, message.leader, message.burst))
