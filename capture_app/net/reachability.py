"""Reachability of a leader at an address; if it cannot be reached, the cause and a remedy in one sentence.

A version request goes out by UDP, and a stream is opened. Together with what the kernel knows of the route,
the results distinguish an absent machine, a machine without a leader, and a firewall.
"""

import asyncio
import contextlib
import errno
import ipaddress
import secrets
import socket
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum, auto
from pathlib import Path

from capture_app.common.address import Address, resolve
from capture_app.common.errors import NetworkError, SimulshotError, UnknownMachineError
from capture_app.common.tasks import end, first_of
from capture_app.common.timeouts import PROBE_TIMEOUT_S
from capture_app.net.channel import SAYS_NOTHING, WHAT_HANGS, open_identified
from capture_app.net.udp import MAX_BYTES, client_socket
from capture_app.sync.wire.codec import (
    TOKEN_BYTES,
    VERSION,
    answered_version,
    version_mismatch,
    version_question,
)
from capture_app.trust.trust import Trust

QUESTION_GAPS_S = (0.0, 0.25, 0.5)
"""Delay before each transmission of the version request, because any datagram may be lost."""
LAST_S = 0.3
"""Part of the timeout that is reserved for the stream after the datagrams."""
_NEIGHBOURS = Path("/proc/net/arp")
_IS_COMPLETE = 0x2


class ProbeAnswer(Enum):
    """Result of sending something to an address."""

    CAME = auto()
    REFUSED = auto()
    """The machine is there, and nothing listens."""
    FORBIDDEN = auto()
    """This machine's own firewall blocked the transmission."""
    UNREACHABLE = auto()
    """No machine is there, or no route to it; or a firewall reports that."""
    NO_ROUTE = auto()
    """This machine has no network that leads there."""
    SILENCE = auto()


@dataclass(frozen=True, slots=True)
class Obstacle:
    """Reason why a leader cannot be reached, and a remedy."""

    what: str
    remedy: str

    def __str__(self) -> str:
        return f"{self.what}: {self.remedy}"


_OF_ERRNO = {
    errno.EPERM: ProbeAnswer.FORBIDDEN,
    errno.EACCES: ProbeAnswer.FORBIDDEN,
    errno.ENETUNREACH: ProbeAnswer.NO_ROUTE,
    errno.EHOSTUNREACH: ProbeAnswer.UNREACHABLE,
    errno.EADDRNOTAVAIL: ProbeAnswer.NO_ROUTE,
}


async def find_obstacle(
    leader: Address, silence_s: float = PROBE_TIMEOUT_S, *, trust: Trust | None = None
) -> Obstacle | None:
    """Return what prevents a connection; None if the leader answers and both machines know each other.

    Each of the two steps takes at most `silence_s`. `trust` is this end's, by default its user's.
    """
    try:
        return await _find_obstacle(leader, *await resolve(leader), silence_s, trust or Trust.of_user())
    except SimulshotError as error:
        return Obstacle(error.what, error.hint)


async def _find_obstacle(
    leader: Address, family: socket.AddressFamily, address: Address, silence_s: float, trust: Trust
) -> Obstacle | None:
    datagrams, streams = asyncio.create_task(_ask(family, address)), asyncio.create_task(_open(address))
    try:
        # Only an answer is conclusive: after a refused stream, the reply datagram may still arrive.
        await asyncio.wait((datagrams,), timeout=silence_s - LAST_S)
        by_udp, version = datagrams.result() if datagrams.done() else (ProbeAnswer.SILENCE, None)
        if by_udp is ProbeAnswer.CAME and version != VERSION:
            what, _, remedy = version_mismatch(version or 0).partition(": ")
            return Obstacle(what, remedy)
        await asyncio.wait((streams,), timeout=silence_s if by_udp is ProbeAnswer.CAME else LAST_S)
        by_tcp = streams.result() if streams.done() else ProbeAnswer.SILENCE
    finally:
        await end(datagrams, streams)
    if by_tcp is ProbeAnswer.CAME and by_udp in (ProbeAnswer.CAME, ProbeAnswer.SILENCE):
        # A hung leader accepts streams, because its kernel does so, and sends nothing on them.
        other = await _why_unknown(leader, address, trust, silence_s)
        if by_udp is ProbeAnswer.CAME or (other is not None and SAYS_NOTHING in other.what):
            return other
    return obstacle(leader, by_udp, by_tcp, is_there=_is_neighbour_there(address.host))


async def first_to_answer(leaders: Sequence[Address], silence_s: float = PROBE_TIMEOUT_S) -> Address | None:
    """Return the leader that answers first, whatever version it speaks; None if none does in time."""

    async def if_it_answers(leader: Address) -> Address | None:
        with contextlib.suppress(NetworkError):
            return leader if (await _ask(*await resolve(leader)))[0] is ProbeAnswer.CAME else None
        return None

    asked = [asyncio.create_task(if_it_answers(leader)) for leader in leaders]
    try:
        for next_one in asyncio.as_completed(asked, timeout=silence_s):
            if (leader := await next_one) is not None:
                return leader
    except TimeoutError:
        pass
    finally:
        await end(*asked)
    return None


async def proves_key(leader: Address, key: str, trust: Trust) -> bool:
    """Return whether a leader answers at an address and proves its key; in an open rig none has to."""
    if trust.is_open:
        return await first_to_answer((leader,)) is not None
    with contextlib.suppress(OSError, SimulshotError):
        async with asyncio.timeout(PROBE_TIMEOUT_S):
            _, writer, who = await open_identified(leader, trust, as_unknown=False)
            writer.close()
            return who.pin == key
    return False


def obstacle(leader: Address, by_udp: ProbeAnswer, by_tcp: ProbeAnswer, *, is_there: bool | None) -> Obstacle:
    """Return what prevents a connection when datagrams or streams fail.

    `is_there`: whether a machine has the address; None if unknown, because it is behind a router or the
    kernel does not report it.
    """
    host, port = leader
    opened = f"sudo ufw allow {port}"
    answers = {by_udp, by_tcp}
    causes = (
        (
            ProbeAnswer.FORBIDDEN in answers,
            f"this machine's own firewall blocks all traffic to {leader}",
            f"allow it, for example: sudo ufw allow out {port}",
        ),
        (
            ProbeAnswer.NO_ROUTE in answers,
            f"this machine has no route to {host}",
            "connect to the leader's network by WiFi or cable",
        ),
        (
            by_udp is ProbeAnswer.CAME,
            f"{leader} answers UDP, but accepts no TCP connection",
            f"allow TCP through its firewall, for example: {opened}/tcp",
        ),
        (
            by_tcp is ProbeAnswer.CAME,
            f"{leader} accepts TCP connections, but does not answer UDP",
            f"allow UDP through its firewall, for example: {opened}/udp; or a leader there hangs,"
            " or it is not a leader's port",
        ),
        (
            ProbeAnswer.REFUSED in answers,
            f"{host} is reachable, but no leader listens on its port {port}",
            "start it there with: capture-app (this machine then joins automatically), or check the port",
        ),
        (
            is_there,
            f"{host} is reachable, but a firewall drops packets to its port {port}",
            f"open it on that machine, for example: {opened}",
        ),
        (
            is_there is False or ProbeAnswer.UNREACHABLE in answers,
            f"no machine answers at {host}",
            "check that it is on, in this network, and has that address:"
            " capture-app doctor on the leader's machine shows its addresses",
        ),
        (
            True,
            f"no reply from {leader}",
            "check its address (capture-app doctor there shows it), and that no firewall drops its"
            f" port: {opened}",
        ),
    )
    return next(Obstacle(what, remedy) for is_so, what, remedy in causes if is_so)


async def _why_unknown(leader: Address, address: Address, trust: Trust, silence_s: float) -> Obstacle | None:
    """Return the obstacle if the two machines are not paired, or the leader does not answer; else None.

    It is also None where pairing is not required.
    """
    if trust.is_open:
        return None
    try:
        async with asyncio.timeout(silence_s):
            (await open_identified(address, trust, as_unknown=False))[1].close()
    except TimeoutError:
        return Obstacle(f"the port of {leader} is open, but {SAYS_NOTHING}", WHAT_HANGS)
    except UnknownMachineError as error:
        return Obstacle(error.what, error.hint)
    except OSError as error:
        return obstacle(leader, ProbeAnswer.CAME, _answer_of(error), is_there=True)
    return None


async def _ask(family: socket.AddressFamily, leader: Address) -> tuple[ProbeAnswer, int | None]:
    """Send version requests by UDP until an answer or a refusal; return it, with the answer's version."""
    with client_socket(family) as sock:
        token = secrets.token_bytes(TOKEN_BYTES)
        try:
            # The kernel reports refusals only to a connected socket.
            sock.connect(leader)
            version = await first_of(_send(sock, version_question(token)), _receive_version(sock, token))
            return ProbeAnswer.CAME, version
        except OSError as error:
            return _answer_of(error), None


async def _send(sock: socket.socket, question: bytes) -> int:
    """Send the version request several times, then wait forever. Raises OSError if it cannot be sent."""
    loop = asyncio.get_running_loop()
    for gap_s in QUESTION_GAPS_S:
        await asyncio.sleep(gap_s)
        await loop.sock_sendall(sock, question)
    never: asyncio.Future[int] = loop.create_future()
    return await never


async def _receive_version(sock: socket.socket, token: bytes) -> int:
    loop = asyncio.get_running_loop()
    while True:
        if (version := answered_version(await loop.sock_recv(sock, MAX_BYTES), token)) is not None:
            return version


async def _open(leader: Address) -> ProbeAnswer:
    """Open a stream, and close it again."""
    try:
        (await asyncio.open_connection(*leader))[1].close()
    except OSError as error:
        return _answer_of(error)
    return ProbeAnswer.CAME


def _answer_of(error: OSError) -> ProbeAnswer:
    # By their types: Windows has other numbers, and resets what is sent to a closed port.
    is_refused = isinstance(error, ConnectionRefusedError | ConnectionResetError)
    return ProbeAnswer.REFUSED if is_refused else _OF_ERRNO.get(error.errno or 0, ProbeAnswer.SILENCE)


def _is_neighbour_there(host: str) -> bool | None:
    """Whether the kernel has resolved the address to hardware on a local network; None if unknown."""
    try:
        searched = ipaddress.ip_address(host)
        rows = map(str.split, _NEIGHBOURS.read_text(encoding="utf-8").splitlines()[1:])
        flags = [int(row[2], 16) for row in rows if ipaddress.ip_address(row[0]) == searched]
    except (OSError, ValueError, IndexError):
        return None
    return any(flag & _IS_COMPLETE for flag in flags) if flags else None
