"""The first moments of a stream: each end proves its key by TLS, before either says a word."""

import asyncio
import asyncio.sslproto
import ssl
from typing import Any, cast

from capture_app.errors import NetworkError, UnknownMachineError
from capture_app.net.address import Address
from capture_app.trust.known_machines import Role
from capture_app.trust.trust import Peer, Trust

GREETING = b"SSH1"
# Each stream of TLS has a buffer of that size from its first moment on: with asyncio's own 256 KiB strangers
# could use the memory up.
asyncio.sslproto.SSLProtocol.max_size = 1 << 15


async def identify_peer(writer: asyncio.StreamWriter, trust: Trust, timeout_s: float) -> Peer:
    """Speak TLS on a stream that has come, see who it is, and greet it. Raises OSError where it does not.

    To be called before anything of the stream is read.
    """
    context = trust.server_context()
    if context is not None:
        plain: Any = writer.transport
        try:
            await writer.start_tls(context, ssl_handshake_timeout=timeout_s)
        except AttributeError as error:
            # Asyncio's own, where the peer went away in that very moment: it leaves no transport to close.
            cast(Any, writer)._transport = plain
            raise ConnectionResetError("the peer went away") from error
        writer.write(GREETING)
    return trust.peer(_certificate(writer))


async def open_identified(
    address: Address, trust: Trust, *, as_stranger: bool
) -> tuple[asyncio.StreamReader, asyncio.StreamWriter, Peer]:
    """Open a stream to a leader that is known here; any leader will do for a stranger.

    Raises OSError, UnknownMachineError where one does not know the other.
    """
    context = trust.client_context(as_stranger=as_stranger)
    try:
        reader, writer = await asyncio.open_connection(*address, ssl=context)
    except (ssl.SSLError, ConnectionResetError, ConnectionAbortedError) as error:
        if context is None:
            raise
        raise UnknownMachineError(
            f"the leader at {address} does not show who it is",
            hint="if it runs with --open, give --open here, too",
        ) from error
    try:
        who = trust.peer(_certificate(writer))
        if not as_stranger and not who.may(Role.LEADER):
            raise UnknownMachineError(
                f"this machine does not know the leader at {address}", hint=_how_to_pair(address)
            )
        if context is not None:
            await _be_greeted(reader, address, trust)
    except BaseException:
        writer.transport.abort()
        raise
    return reader, writer, who


async def _be_greeted(reader: asyncio.StreamReader, address: Address, trust: Trust) -> None:
    """Wait until the leader has seen who speaks: to one that it does not know it says nothing at all."""
    try:
        greeting = await reader.readexactly(len(GREETING))
    except (OSError, asyncio.IncompleteReadError) as error:
        raise UnknownMachineError(
            f"the leader at {address} does not know this machine",
            hint=f"{_how_to_pair(address)}; or there: capture-app trust add {trust.identity.pin}",
        ) from error
    if greeting != GREETING:
        raise NetworkError(f"{address} is no leader's port", hint="check host and port")


def _how_to_pair(leader: Address) -> str:
    return (
        f"pair them once: capture-app trust pair {leader} --code CODE, with the code that"
        " capture-app trust invite shows on the leader's machine"
    )


def _certificate(writer: asyncio.StreamWriter) -> bytes | None:
    """What the peer has shown, with the proof of its key: in DER."""
    tls: ssl.SSLObject | None = writer.get_extra_info("ssl_object")
    return None if tls is None else tls.getpeercert(binary_form=True)
