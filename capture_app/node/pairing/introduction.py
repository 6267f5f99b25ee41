"""A machine's part of becoming known to a leader."""

import asyncio
import socket
from typing import Any, TypeVar

from capture_app.errors import NetworkError, SimulshotError, UnknownMachineError
from capture_app.names import name_like
from capture_app.net.address import Address
from capture_app.net.channel import Channel, connect
from capture_app.node.wire import messages, pairing
from capture_app.node.wire.message import Message
from capture_app.trust.known_machines import Role
from capture_app.trust.pairing import Candidate
from capture_app.trust.trust import Trust

ANSWER_TIMEOUT_S = 10.0

A = TypeVar("A", bound=Message)


async def is_known(leader: Address, trust: Trust) -> bool:
    """Whether this machine and a leader know each other. Raises NetworkError where it does not answer."""
    try:
        async with await connect(leader, messages.FromLeader, trust=trust):
            return True
    except UnknownMachineError:
        return False


async def knock(leader: Address, trust: Trust) -> None:
    """Show this machine to a leader that is known here, which may have been given its pin.

    Raises UnknownMachineError where it was not, or is not known here, NetworkError.
    """
    async with await connect(leader, messages.FromLeader, trust=trust, as_stranger=True) as channel:
        if not channel.who.may(Role.LEADER):
            raise UnknownMachineError(f"this machine does not know the leader at {leader}")
        await _ask(channel, pairing.Knock(certificate=trust.identity.certificate), pairing.Known)


async def pair(leader: Address, code: str, trust: Trust) -> tuple[Role, ...]:
    """Make this machine and a leader known to each other by a code, and return what it may do there.

    Raises UnknownMachineError where it is not the code, NetworkError, DiskError.
    """
    own = trust.identity
    async with await connect(leader, messages.FromLeader, trust=trust, as_stranger=True) as channel:
        shown = channel.who.pin
        candidate = await asyncio.to_thread(Candidate, code, own.pin, shown)
        name = name_like(socket.gethostname().split(".")[0], "machine")
        word = pairing.PairingWord(certificate=own.certificate, name=name, share=candidate.share)
        answer = await _ask(channel, word, pairing.PairingAnswer)
        proof = await asyncio.to_thread(candidate.prove, answer.share)
        known = await _ask(channel, pairing.PairingProof(proof=proof), pairing.Known)
        candidate.check(known.proof)
    trust.known.add(shown, Role.LEADER, name=known.leader)
    return known.roles


async def _ask(channel: Channel[Any], message: Message, kind: type[A]) -> A:
    await channel.send(message)
    try:
        async with asyncio.timeout(ANSWER_TIMEOUT_S):
            answer = await channel.receive_header()
    except TimeoutError as error:
        raise NetworkError(f"the leader at {channel.peer} does not answer") from error
    if isinstance(answer, messages.Refusal):
        raise answer.as_error()
    if not isinstance(answer, kind):
        raise SimulshotError(
            f"the leader at {channel.peer} did not answer that", hint="is it of this version?"
        )
    return answer
