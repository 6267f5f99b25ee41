"""Requests to a running leader, as the command line makes them."""

import asyncio
from collections.abc import AsyncIterator
from typing import Any

from capture_app.errors import NetworkError
from capture_app.net.address import Address
from capture_app.net.channel import Channel, connect
from capture_app.node.wire import messages
from capture_app.node.wire.status import BurstStatus, RigStatus

ANSWER_TIMEOUT_S = 10.0


async def ask_status(leader: Address) -> RigStatus:
    """Return the status of the rig of a running leader. Raises NetworkError."""
    async with await connect(leader, messages.FromLeader) as channel:
        await channel.send(messages.StatusRequest())
        answer = await _next(channel)
        if not isinstance(answer, messages.StatusAnswer):
            raise NetworkError(f"the leader at {leader} sent no status")
        return answer.rig


async def ask_burst(leader: Address, request: messages.BurstRequest) -> AsyncIterator[BurstStatus]:
    """Order a burst and yield its progress until it is done.

    Raises NetworkError, and the leader's own errors.
    """
    async with await connect(leader, messages.FromLeader) as channel:
        await channel.send(request)
        while True:
            # The leader tells how far it is once a second at least: silence means that it is gone.
            answer = await _next(channel)
            if isinstance(answer, messages.BurstAnswer):
                yield answer.burst
                if answer.burst.done:
                    return


async def _next(channel: Channel[Any]) -> messages.FromLeader:
    try:
        async with asyncio.timeout(ANSWER_TIMEOUT_S):
            received = await channel.receive()
    except TimeoutError as error:
        raise NetworkError(f"the leader at {channel.peer} does not answer") from error
    if received is None:
        raise NetworkError(f"the leader at {channel.peer} closed the connection", hint="was it stopped?")
    answer: messages.FromLeader = received[0]
    if isinstance(answer, messages.Refusal):
        raise answer.as_error()
    return answer
