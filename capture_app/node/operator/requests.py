"""Requests to a running leader, as commands and the screen make them."""

import asyncio
from collections.abc import AsyncIterator, Mapping
from typing import Any, TypeVar

from capture_app.camera_controls import CameraControls, Control, ControlValue
from capture_app.camera_facts import StampAccuracy
from capture_app.errors import NetworkError
from capture_app.net.address import Address
from capture_app.net.channel import Channel, connect
from capture_app.node.wire import messages, operating, pairing
from capture_app.node.wire.message import Message
from capture_app.node.wire.status import BurstStatus, RigStatus
from capture_app.node.wire.views import NodeDetail
from capture_app.trust.known_machines import Role
from capture_app.trust.trust import Trust

ANSWER_TIMEOUT_S = 10.0
ORDER_TIMEOUT_S = 40.0
"""A camera that is started has to be opened first."""

A = TypeVar("A", bound=Message)


async def ask_status(leader: Address) -> RigStatus:
    """Return the status of the rig of a running leader. Raises NetworkError."""
    return (await _ask(leader, messages.StatusRequest(), messages.StatusAnswer)).rig


async def ask_detail(leader: Address, camera: str) -> NodeDetail:
    """Return all that a node knows of itself. Raises NetworkError, and the leader's own errors."""
    return (await _ask(leader, operating.DetailRequest(camera=camera), operating.DetailAnswer)).detail


async def ask_controls(
    leader: Address, camera: str, wanted: Mapping[Control, ControlValue]
) -> CameraControls:
    """Set what is wanted of a camera's controls, nothing if empty; return them all as they stand then.

    Raises NetworkError, and the leader's own errors.
    """
    request = operating.ControlsRequest(camera=camera, wanted=dict(wanted))
    return (await _ask(leader, request, operating.ControlsAnswer)).state


async def tell_stamp(leader: Address, camera: str, stamp: StampAccuracy) -> bool:
    """Let a camera's node go by what was measured of its stamps; whether it keeps it for the next time.

    Raises NetworkError, and the leader's own errors.
    """
    order = operating.KeepStamp(camera=camera, stamp=stamp)
    return (await _ask(leader, order, operating.StampKept)).kept


async def give_order(leader: Address, order: operating.Order) -> tuple[str, ...]:
    """Return when the leader has done it, with the names of cameras that it started.

    Raises NetworkError, and the leader's own errors.
    """
    return (await _ask(leader, order, operating.Done, ORDER_TIMEOUT_S)).names


async def ask_invitation(leader: Address, role: Role) -> pairing.Invited:
    """Return a code by which one machine becomes known to the leader. Raises NetworkError."""
    return await _ask(leader, pairing.Invite(role=role), pairing.Invited)


async def ask_phone_invitation(leader: Address) -> operating.PhoneInvited:
    """Return the page of the next phone. Raises NetworkError, and the leader's errors."""
    return await _ask(leader, operating.InvitePhone(), operating.PhoneInvited, ORDER_TIMEOUT_S)


async def ask_burst(leader: Address, request: messages.BurstRequest) -> AsyncIterator[BurstStatus]:
    """Order a burst and yield its progress until it is done.

    Raises NetworkError, and the leader's own errors.
    """
    async with await connect(leader, messages.FromLeader) as channel:
        await channel.send(request)
        while True:
            # The leader tells how far it is once a second at least: silence means that it is gone.
            answer = await receive_answer(channel)
            if isinstance(answer, messages.BurstAnswer):
                yield answer.burst
                if answer.burst.done:
                    return


async def receive_answer(channel: Channel[Any], timeout_s: float = ANSWER_TIMEOUT_S) -> messages.FromLeader:
    """Return the leader's next message, without its payload. Raises NetworkError, and the leader's errors."""
    try:
        async with asyncio.timeout(timeout_s):
            answer: messages.FromLeader | None = await channel.receive_header()
    except TimeoutError as error:
        raise NetworkError(f"the leader at {channel.peer} does not answer") from error
    if answer is None:
        asks = ", or does it ask who you are? leave out --open" if Trust.of_user().is_open else "?"
        raise NetworkError(
            f"the leader at {channel.peer} closed the connection", hint=f"was it stopped{asks}"
        )
    if isinstance(answer, messages.Refusal):
        raise answer.as_error()
    return answer


async def _ask(leader: Address, request: Message, kind: type[A], timeout_s: float = ANSWER_TIMEOUT_S) -> A:
    async with await connect(leader, messages.FromLeader) as channel:
        await channel.send(request)
        answer = await receive_answer(channel, timeout_s)
        if not isinstance(answer, kind):
            raise NetworkError(
                f"the leader at {leader} sent a {type(answer).__name__}, not a {kind.__name__}"
            )
        return answer
