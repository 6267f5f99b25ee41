"""Streams over TLS: messages with a raw payload, on the same port number as the leader's UDP.

4 bytes   b"SSH1", so that another protocol on the port is detected at once
4 bytes   length of the header, big-endian
8 bytes   length of the payload, big-endian
header    one message, tagged JSON
payload   an image and its ground truth, if any

Each end proves its key before either sends a message, unless the rig is open. An unknown peer has a limited
time, so that it cannot occupy the port.
"""

import asyncio
import asyncio.sslproto
import contextlib
import os
import socket
import ssl
import struct
from collections.abc import AsyncIterator
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from dataclasses import dataclass, replace
from typing import Any, Generic, TypeVar, cast

import msgspec

from capture_app.common.address import DEFAULT_PORT, Address
from capture_app.common.errors import NetworkError, SimulshotError, UnknownMachineError
from capture_app.common.pairing_codes import Role
from capture_app.common.tasks import first_of
from capture_app.common.text import UNREADABLE, printable_json
from capture_app.common.timeouts import CLOSE_TIMEOUT_S
from capture_app.trust.trust import UNKNOWN_PEER, Peer, Trust

# Every TLS stream allocates a buffer of this size at once. With asyncio's own 256 KiB, unknown peers could
# exhaust the memory; a known one's stream gets a larger buffer, which takes a sixth off its processor time.
asyncio.sslproto.SSLProtocol.max_size = 1 << 15
MAX_HEADER_BYTES = 1 << 20
MAGIC = b"SSH1"
"""Beginning of every message, and the greeting of a machine that is known."""
MAX_PAYLOAD_BYTES = 64 << 20
CHUNK_BYTES = 1 << 18
"""Maximum number of bytes in one read of a stream; up to twice as many are buffered unread."""
CONNECT_TIMEOUT_S, OPEN_TIMEOUT_S = 5.0, 1.0
SAYS_NOTHING = "nothing there answers"
WHAT_HANGS = "check that a leader runs there; if it hangs or is suspended (Ctrl-Z), restart it"
_TOO_SLOW = "the rest of a message did not arrive in time"
_BROKEN = "the connection broke off in the middle of a message"
_CHECK_LINK = "check the network on both machines: capture-app doctor"
_PREFIX = struct.Struct(">4sIQ")
M = TypeVar("M")


async def open_identified(
    address: Address, trust: Trust, *, as_unknown: bool
) -> tuple[asyncio.StreamReader, asyncio.StreamWriter, Peer]:
    """Open a stream to a leader that this machine knows; with `as_unknown`, to any leader.

    Raises OSError, UnknownMachineError where either end does not know the other.
    """
    context = trust.client_context(as_unknown=as_unknown)
    try:
        reader, writer = await asyncio.open_connection(*address, ssl=context)
    except (ssl.SSLError, ConnectionResetError, ConnectionAbortedError) as error:
        if context is None:
            raise
        # An attacker may have cut the handshake: never fall back to an unauthenticated stream.
        is_paired = any(Role.LEADER in machine.roles for machine in trust.known.all())
        why = ": it is no longer paired with this machine, or another machine answers" if is_paired else ""
        raise UnknownMachineError(
            f"the leader at {address} does not prove its identity{why}",
            hint="check the address on its screen, which shows OPEN where pairing is skipped",
        ) from error
    try:
        who = trust.peer(_certificate(writer))
        if not as_unknown and not who.may(Role.LEADER):
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
    """Wait for the leader's greeting, which a machine that the leader does not know never receives."""
    try:
        greeting = await reader.readexactly(len(MAGIC))
    except (OSError, asyncio.IncompleteReadError) as error:
        raise UnknownMachineError(
            f"the leader at {address} does not know this machine",
            hint=f"{_how_to_pair(address)}; or there: capture-app trust add {trust.identity.pin}",
        ) from error
    if greeting != MAGIC:
        raise NetworkError(f"{address} is not a leader's port", hint="check host and port")


def _how_to_pair(leader: Address) -> str:
    return (
        f"pair them once: capture-app trust pair {leader} --code CODE, with the code that"
        " capture-app trust invite shows on the leader's machine"
    )


def _certificate(writer: asyncio.StreamWriter) -> bytes | None:
    """Return the peer's certificate in DER, whose key the handshake has verified; None without TLS."""
    tls: ssl.SSLObject | None = writer.get_extra_info("ssl_object")
    return None if tls is None else tls.getpeercert(binary_form=True)


@dataclass(frozen=True, slots=True)
class StreamTimeouts:
    """Timeouts for a peer, in s, and the header limit while it is unknown."""

    first_s: float | None = 10.0
    """Until its first message."""
    idle_s: float | None = 120.0
    """Between two messages; None for no limit."""
    message_s: float | None = 30.0
    """For the rest of a message, for the next chunk of a payload, and for the peer to take in a message."""
    header_bytes: int = 1 << 16
    """Maximum header length of a peer that is still unknown."""


FOR_EVER = StreamTimeouts(first_s=None, idle_s=None, message_s=None, header_bytes=MAX_HEADER_BYTES)


class UnreadableMessageError(NetworkError):
    """The peer sent a message of no known type, or with a value out of range."""


class TooLargeMessageError(NetworkError):
    """A message that no peer would accept was not sent; the stream goes on."""


class Channel(Generic[M], AbstractAsyncContextManager["Channel[M]"]):
    """One open stream of messages; `M` is the union of messages that may arrive."""

    def __init__(
        self,
        reader: asyncio.StreamReader,
        writer: asyncio.StreamWriter,
        decoder: msgspec.json.Decoder[M],
        stream_timeouts: StreamTimeouts = FOR_EVER,
    ) -> None:
        self.has_spoken = False
        """Whether the peer has sent a message."""
        self.is_known = False
        """Whether the peer is a node that has joined; its headers may have any allowed length."""
        self.is_beyond = False
        """Whether the stream was admitted beyond the limits, because it may be an operator's."""
        self.who: Peer = UNKNOWN_PEER
        """The peer's identity, as proven by its key."""
        where = writer.get_extra_info("peername") or ("?", 0)
        self.peer = Address(str(where[0]), int(where[1]))
        """Address of the other end, stored because TLS does not return it once the stream has ended."""
        self.unread = 0
        """Number of bytes of the last message's payload that are not read yet."""
        self._reader, self._writer = reader, writer
        self._decoder, self._stream_timeouts = decoder, stream_timeouts

    @property
    def machine(self) -> str:
        """Machine at the other end, whose streams share its limits: its pin; in an open rig its host."""
        return self.who.via or self.who.pin or self.peer.host

    async def identify(self, trust: Trust) -> None:
        """Start TLS on an accepted stream, identify the peer and greet it. Raises OSError where that fails.

        Call it before anything is read from the stream.
        """
        writer, context = self._writer, trust.server_context()
        plain: Any = writer.transport
        if context is not None:
            try:
                await writer.start_tls(
                    context, ssl_handshake_timeout=self._stream_timeouts.first_s or CONNECT_TIMEOUT_S
                )
            except AttributeError as error:
                # A bug of asyncio where the peer disconnects at this moment: it leaves no transport to close.
                cast(Any, writer)._transport = plain
                raise ConnectionResetError("the peer disconnected") from error
            writer.write(MAGIC)
        self.who = trust.peer(_certificate(writer))
        if context is not None and self.who.roles:
            plain.get_protocol().max_size = CHUNK_BYTES

    def allow_silence(self) -> None:
        """Remove the timeout between messages, for a peer that mainly receives."""
        self._stream_timeouts = replace(self._stream_timeouts, idle_s=None)

    @asynccontextmanager
    async def _reading(self, silence_s: float | None, too_slow: str) -> AsyncIterator[None]:
        try:
            async with asyncio.timeout(silence_s):
                yield
        except TimeoutError as error:
            raise NetworkError(too_slow, hint=_CHECK_LINK) from error
        except asyncio.IncompleteReadError as error:
            raise NetworkError(_BROKEN, hint=_CHECK_LINK) from error
        except OSError as error:
            raise NetworkError(f"the connection broke off: {error}", hint=_CHECK_LINK) from error

    async def receive_header(self) -> M | None:
        """Read one message without its payload, which `payload` reads; skip what is left of the last payload.

        Return None if the peer closed the stream between messages. Raises NetworkError for a stream that
        breaks off, is too large, or does not speak the transfer protocol.
        """
        async for _ in self.payload():
            pass
        silence_s = self._stream_timeouts.idle_s if self.has_spoken else self._stream_timeouts.first_s
        async with self._reading(silence_s, "the peer was silent for too long"):
            try:
                prefix = await self._reader.readexactly(_PREFIX.size)
            except asyncio.IncompleteReadError as error:
                if not error.partial:
                    return None
                raise
        magic, header_bytes, payload_bytes = _PREFIX.unpack(prefix)
        if magic != MAGIC:
            raise NetworkError("the peer does not speak the transfer protocol", hint="check host and port")
        max_header_bytes = MAX_HEADER_BYTES if self.is_known else self._stream_timeouts.header_bytes
        if header_bytes > max_header_bytes or payload_bytes > MAX_PAYLOAD_BYTES:
            raise NetworkError(
                f"a message of {header_bytes} + {payload_bytes} bytes is over the limit of "
                f"{max_header_bytes} + {MAX_PAYLOAD_BYTES}"
            )
        async with self._reading(self._stream_timeouts.message_s, _TOO_SLOW):
            header = await self._reader.readexactly(header_bytes)
        self.unread = payload_bytes
        try:
            # Peers' text reaches screens and logs: it must not contain control sequences for a terminal.
            message = self._decoder.decode(printable_json(header))
        except (*UNREADABLE, SimulshotError) as error:
            raise UnreadableMessageError(
                f"unreadable message: {error}", hint="install the same version of simulshot on both machines"
            ) from error
        self.has_spoken = True
        return message

    async def payload(self) -> AsyncIterator[bytes]:
        """Yield the last message's payload as it arrives. Raises NetworkError where it breaks off."""
        while self.unread:
            async with self._reading(self._stream_timeouts.message_s, _TOO_SLOW):
                chunk = await self._reader.read(min(self.unread, CHUNK_BYTES))
            if not chunk:
                raise NetworkError(_BROKEN, hint=_CHECK_LINK)
            self.unread -= len(chunk)
            yield chunk

    async def send(
        self, message: msgspec.Struct, *payloads: bytes | memoryview, stall_s: float | None = None
    ) -> None:
        """Write one message and its payload, and wait until the peer has caught up, however slow it is.

        `stall_s` is the maximum time without progress, by default the stream's `message_s`. Raises
        NetworkError where that time passes, the stream has broken off or the message is too large.
        """
        header = msgspec.json.encode(message)
        payload_bytes = sum(map(len, payloads))
        if len(header) > MAX_HEADER_BYTES or payload_bytes > MAX_PAYLOAD_BYTES:
            raise TooLargeMessageError(
                f"a message of {len(header)} + {payload_bytes} bytes is too large to send",
                hint="use fewer cameras in one rig, or shorter names",
            )
        try:
            if self._writer.is_closing():
                # asyncio would print a line for each further part that is written.
                raise ConnectionResetError("Connection lost")
            self._writer.write(_PREFIX.pack(MAGIC, len(header), payload_bytes) + header)
            # Without a wait in between, because other tasks may send on this stream too.
            for payload in payloads:
                self._writer.write(payload)
            await self._drain(self._stream_timeouts.message_s if stall_s is None else stall_s)
        except TimeoutError as error:
            # Closing would wait for the same stalled peer.
            self.abort()
            raise NetworkError("the peer does not receive anything", hint=_CHECK_LINK) from error
        except OSError as error:
            raise NetworkError(f"the connection broke off: {error}", hint=_CHECK_LINK) from error

    async def _drain(self, stall_s: float | None) -> None:
        """Wait until most of what was written has been taken in. Raises TimeoutError if nothing is."""
        while True:
            before = self._writer.transport.get_write_buffer_size()
            try:
                async with asyncio.timeout(stall_s):
                    return await self._writer.drain()
            except TimeoutError:
                if self._writer.transport.get_write_buffer_size() >= before:
                    raise

    async def relay(self, other: "Channel[Any]") -> None:
        """Forward all bytes between two streams, unread and in both directions, until either ends."""
        await first_of(self._copy_to(other._writer), other._copy_to(self._writer))

    async def _copy_to(self, writer: asyncio.StreamWriter) -> None:
        with contextlib.suppress(OSError):
            while chunk := await self._reader.read(CHUNK_BYTES):
                self.has_spoken = True
                writer.write(chunk)
                await writer.drain()

    def abort(self) -> None:
        """Break the stream off; every pending read and write raises NetworkError at once."""
        # TLS of Python 3.11.2 (Debian 12) raises once its connection is lost.
        with contextlib.suppress(AttributeError):
            self._writer.transport.abort()

    async def close(self) -> None:
        """Close the stream once its peer has everything, or on timeout; harmless on a broken stream."""
        # A second close() makes TLS of Python 3.11.2 forget the connection that abort() is for.
        if not self._writer.is_closing():
            self._writer.close()
        message_s = self._stream_timeouts.message_s
        try:
            async with asyncio.timeout(CLOSE_TIMEOUT_S if message_s is None else message_s):
                await self._writer.wait_closed()
        except OSError:
            self.abort()

    async def __aexit__(self, error: type[BaseException] | None, *_: object) -> None:
        if error is asyncio.CancelledError and self._stream_timeouts is FOR_EVER:
            # A program that is stopped does not wait for a leader that it may not reach.
            self.abort()
        await self.close()


async def connect(
    address: Address,
    messages: Any,
    *,
    timeout_s: float = CONNECT_TIMEOUT_S,
    trust: Trust | None = None,
    as_unknown: bool = False,
) -> Channel[Any]:
    """Open a stream to a leader; `messages` is the union that may arrive.

    `trust` is this end's identity and known machines, by default its user's. With `as_unknown` any leader is
    accepted and this end shows no certificate, so that it can only ask to be enrolled. Raises NetworkError,
    UnknownMachineError where either end does not know the other.
    """
    trust = trust or Trust.of_user()
    try:
        async with asyncio.timeout(timeout_s):
            reader, writer, who = await open_identified(address, trust, as_unknown=as_unknown)
    except socket.gaierror as error:
        raise NetworkError(
            f"cannot resolve host {address.host!r}: {error.strerror}",
            hint="check the name, or give its IP address",
        ) from error
    except TimeoutError as error:
        what = f"no answer from a leader at {address} within {timeout_s:g} s"
        hint = "check address and firewall"
        with contextlib.suppress(OSError):
            async with asyncio.timeout(OPEN_TIMEOUT_S):
                (await asyncio.open_connection(*address))[1].close()
            what, hint = f"the port of {address} is open, but {SAYS_NOTHING}", WHAT_HANGS
        raise NetworkError(what, hint=hint) from error
    except (OSError, UnicodeError) as error:
        port = "" if address.port == DEFAULT_PORT else f" --port {address.port}"
        # asyncio's own text repeats the address as a tuple.
        why = os.strerror(error.errno) if isinstance(error, OSError) and error.errno else str(error)
        raise NetworkError(
            f"no leader at {address}: {why}",
            hint=f"capture-app rig list shows what runs here; start one with: capture-app rig start{port}",
        ) from error
    channel = Channel[Any](reader, writer, msgspec.json.Decoder(messages))
    channel.who = who
    return channel
