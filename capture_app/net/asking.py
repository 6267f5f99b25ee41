"""Requests to a leader over a stream, and their answers."""

import asyncio
from typing import Any, TypeVar

from msgspec.structs import replace

from capture_app.common.bounds import Message
from capture_app.common.errors import NetworkError
from capture_app.common.timeouts import ANSWER_TIMEOUT_S
from capture_app.net.channel import Channel
from capture_app.protocol import messages
from capture_app.protocol.status import NodeStatus, RigStatus
from capture_app.trust.trust import OPEN_VARIABLE, Trust

A = TypeVar("A", bound=Message)


async def next_message(channel: Channel[Any], timeout_s: float, hint: str = "") -> messages.FromLeader:
    """Return the leader's next message, which may be a refusal, without its payload.

    Raises NetworkError; `hint` is for a leader that does not answer.
    """
    try:
        async with asyncio.timeout(timeout_s):
            answer: messages.FromLeader | None = await channel.receive_header()
    except TimeoutError as error:
        raise NetworkError(
            f"the leader at {channel.peer} does not answer",
            hint=hint or f"look for the cause: capture-app doctor --leader {channel.peer}",
        ) from error
    if answer is None:
        asks = f"; if it requires pairing: unset {OPEN_VARIABLE}" if Trust.of_user().is_open else ""
        raise NetworkError(
            f"the leader at {channel.peer} closed the connection", hint=f"check that it runs{asks}"
        )
    return answer


async def receive_answer(channel: Channel[Any], timeout_s: float = ANSWER_TIMEOUT_S) -> messages.FromLeader:
    """Return the leader's next message, without its payload. Raises NetworkError, and the leader's errors."""
    answer = await next_message(channel, timeout_s)
    if isinstance(answer, messages.Refusal):
        raise answer.as_error()
    return answer


async def ask(
    channel: Channel[Any], request: Message, kind: type[A], timeout_s: float = ANSWER_TIMEOUT_S
) -> A:
    """Send a request and return its answer, of type `kind`. Raises NetworkError, and the leader's errors."""
    await channel.send(request)
    answer = await receive_answer(channel, timeout_s)
    if not isinstance(answer, kind):
        raise NetworkError(
            f"the leader at {channel.peer} sent a {type(answer).__name__}, not a {kind.__name__}",
            hint="install the same version of simulshot on both machines",
        )
    return answer


async def ask_all_nodes(channel: Channel[Any]) -> RigStatus:
    """Return the status of a rig, with all its nodes. Raises NetworkError, and the leader's errors."""
    nodes: list[NodeStatus] = []
    while True:
        request = messages.StatusRequest(after=nodes[-1].name if nodes else "")
        rig = (await ask(channel, request, messages.StatusAnswer)).rig
        nodes += rig.nodes
        if not rig.further or not rig.nodes:
            return replace(rig, nodes=tuple(nodes))
