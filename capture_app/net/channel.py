"""Transfer streams: messages with a raw payload over TCP, on the same port number as the leader's UDP.

4 bytes   b"SSH1", so that a stranger on the port is noticed at once
4 bytes   length of the header, big-endian
8 bytes   length of the payload, big-endian
header    one message, tagged JSON
payload   an image and what belongs to it

All of it is in TLS, but where a port is open to anybody.
"""

import asyncio
import contextlib
import socket
import struct
from collections.abc import AsyncIterator
from typing import Any, Generic, Self, TypeVar

import msgspec

from capture_app.errors import NetworkError, SimulshotError
from capture_app.net.address import Address
from capture_app.net.identification import identify_peer, open_identified
from capture_app.net.stream_limits import Patience
from capture_app.text import UNREADABLE, printable_json
from capture_app.trust.trust import STRANGER, Peer, Trust

MAGIC = b"SSH1"
MAX_HEADER_BYTES = 1 << 20
MAX_PAYLOAD_BYTES = 64 << 20
CHUNK_BYTES = 1 << 18
"""The most that is read of a stream at once, and half of what is kept of it unread."""
CONNECT_TIMEOUT_S = 5.0
CLOSE_TIMEOUT_S = 30.0
"""Until what was sent last is taken in, of a stream that is closed."""
_TOO_SLOW = "the rest of a message did not come in time"
_BROKEN = "the transfer broke off in the middle of a message"

_PREFIX = struct.Struct(">4sIQ")
_ENCODER = msgspec.json.Encoder()

M = TypeVar("M")


class Channel(Generic[M]):
    """One open stream of messages; `M` is the union of messages that may arrive."""

    def __init__(
        self,
        reader: asyncio.StreamReader,
        writer: asyncio.StreamWriter,
        decoder: msgspec.json.Decoder[M],
        patience: Patience | None = None,
    ) -> None:
        """Without `patience` this waits for ever: whoever has asked has limits of its own."""
        self.has_spoken = False
        """Whether the peer has sent a message."""
        self.is_known = False
        """Whether it is a node that has joined."""
        self.who: Peer = STRANGER
        """Who the peer is, as far as its key shows it."""
        where = writer.get_extra_info("peername") or ("?", 0)
        self.peer = Address(str(where[0]), int(where[1]))
        """Address of the other end; TLS does not tell it any more when the stream has ended."""
        self._reader = reader
        self._writer = writer
        self._decoder = decoder
        self._unread = 0
        self._header_bytes = MAX_HEADER_BYTES if patience is None else patience.header_bytes
        self._first_s = None if patience is None else patience.first_s
        self._idle_s = None if patience is None else patience.idle_s
        self._message_s = None if patience is None else patience.message_s

    @property
    def host(self) -> str:
        """Host of the other end."""
        return self.peer.host

    async def identify(self, trust: Trust) -> None:
        """See who has come, before anything of the stream is read. Raises OSError where it does not show."""
        self.who = await identify_peer(self._writer, trust, self._first_s or CONNECT_TIMEOUT_S)

    def trust(self) -> None:
        """Take messages of any allowed length from now on: the peer is known."""
        self.is_known = True
        self._header_bytes = MAX_HEADER_BYTES

    def allow_silence(self) -> None:
        """Let the peer be silent between messages for as long as it likes: it is told things."""
        self._idle_s = None

    async def receive(self) -> tuple[M, bytes] | None:
        """Read one message and its payload; None where the peer has closed the stream between messages.

        Raises NetworkError for a stream that breaks off, is too large, or is no transfer stream at all.
        """
        message = await self.receive_header()
        return None if message is None else (message, b"".join([chunk async for chunk in self.payload()]))

    async def receive_header(self) -> M | None:
        """Read one message without its payload, for `payload` to read; what it left is skipped.

        Returns and raises as `receive` does.
        """
        async for _ in self.payload():
            pass
        try:
            async with asyncio.timeout(self._idle_s if self.has_spoken else self._first_s):
                prefix = await self._reader.readexactly(_PREFIX.size)
        except TimeoutError as error:
            raise NetworkError("the peer was silent for too long") from error
        except asyncio.IncompleteReadError as error:
            if error.partial:
                raise NetworkError(_BROKEN) from error
            return None
        except OSError as error:
            raise NetworkError(f"the transfer broke off: {error}") from error
        magic, header_bytes, payload_bytes = _PREFIX.unpack(prefix)
        if magic != MAGIC:
            raise NetworkError("the peer does not speak the transfer protocol", hint="check host and port")
        if header_bytes > self._header_bytes or payload_bytes > MAX_PAYLOAD_BYTES:
            raise NetworkError(
                f"a message of {header_bytes} + {payload_bytes} bytes is over the limit of "
                f"{self._header_bytes} + {MAX_PAYLOAD_BYTES}"
            )
        try:
            async with asyncio.timeout(self._message_s):
                header = await self._reader.readexactly(header_bytes)
        except TimeoutError as error:
            raise NetworkError(_TOO_SLOW) from error
        except (asyncio.IncompleteReadError, OSError) as error:
            raise NetworkError(_BROKEN) from error
        self._unread = payload_bytes
        try:
            # What a peer says reaches screens and logs: none of it may steer a terminal.
            message = self._decoder.decode(printable_json(header))
        except (*UNREADABLE, SimulshotError) as error:
            raise NetworkError(
                f"unreadable message: {error}", hint="do both ends run the same version?"
            ) from error
        self.has_spoken = True
        return message

    async def payload(self) -> AsyncIterator[bytes]:
        """Yield the last message's payload as it comes in. Raises NetworkError where it breaks off."""
        while self._unread:
            try:
                async with asyncio.timeout(self._message_s):
                    chunk = await self._reader.read(min(self._unread, CHUNK_BYTES))
            except TimeoutError as error:
                raise NetworkError(_TOO_SLOW) from error
            except OSError as error:
                raise NetworkError(f"the transfer broke off: {error}") from error
            if not chunk:
                raise NetworkError(_BROKEN)
            self._unread -= len(chunk)
            yield chunk

    async def send(
        self, message: msgspec.Struct, *payloads: bytes | memoryview, stall_s: float | None = None
    ) -> None:
        """Write one message and its payload, and wait until the peer keeps up, however slow it is.

        `stall_s` is how long it may take nothing in, else the stream's patience. Raises NetworkError where
        it does not, the stream has broken off or the message is too large.
        """
        header = _ENCODER.encode(message)
        payload_bytes = sum(map(len, payloads))
        if len(header) > MAX_HEADER_BYTES or payload_bytes > MAX_PAYLOAD_BYTES:
            raise NetworkError(f"a message of {len(header)} + {payload_bytes} bytes is too large to send")
        try:
            self._writer.write(_PREFIX.pack(MAGIC, len(header), payload_bytes) + header)
            # All at once: other tasks may send on this stream too.
            for payload in payloads:
                self._writer.write(payload)
            await self._drain(self._message_s if stall_s is None else stall_s)
        except TimeoutError as error:
            # Closing would wait for the same peer.
            self.abort()
            raise NetworkError("the peer takes nothing in") from error
        except OSError as error:
            raise NetworkError(f"the transfer broke off: {error}") from error

    async def _drain(self, stall_s: float | None) -> None:
        """Wait until most of what was written is taken in. Raises TimeoutError where nothing is."""
        while True:
            before = self._writer.transport.get_write_buffer_size()
            try:
                async with asyncio.timeout(stall_s):
                    return await self._writer.drain()
            except TimeoutError:
                if self._writer.transport.get_write_buffer_size() >= before:
                    raise

    async def relay(self, other: "Channel[Any]") -> None:
        """Pass all bytes on between two streams, both ways and unread, until either closes or breaks off."""
        ways = (
            asyncio.create_task(self._copy_to(other._writer)),
            asyncio.create_task(other._copy_to(self._writer)),
        )
        try:
            await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for way in ways:
                way.cancel()
            await asyncio.gather(*ways, return_exceptions=True)

    async def _copy_to(self, writer: asyncio.StreamWriter) -> None:
        with contextlib.suppress(OSError):
            while chunk := await self._reader.read(CHUNK_BYTES):
                self.has_spoken = True
                writer.write(chunk)
                await writer.drain()

    def abort(self) -> None:
        """Break the stream off: all who wait for it get a NetworkError at once."""
        self._writer.transport.abort()

    async def close(self) -> None:
        """Close the stream when its peer has all, or takes too long; harmless where it has broken already."""
        self._writer.close()
        try:
            async with asyncio.timeout(CLOSE_TIMEOUT_S if self._message_s is None else self._message_s):
                await self._writer.wait_closed()
        except TimeoutError:
            self.abort()
        except OSError:
            pass

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()


async def connect(
    address: Address,
    messages: Any,
    *,
    timeout_s: float = CONNECT_TIMEOUT_S,
    trust: Trust | None = None,
    as_stranger: bool = False,
) -> Channel[Any]:
    """Open a stream to a leader; `messages` is the union that may arrive.

    `trust` is what this end goes by, else its user's. With `as_stranger` any leader will do, and it is not
    told who asks: whoever is not known yet says nothing but that.
    Raises NetworkError, UnknownMachineError where one end does not know the other.
    """
    trust = trust or Trust.of_user()
    try:
        async with asyncio.timeout(timeout_s):
            reader, writer, who = await open_identified(address, trust, as_stranger=as_stranger)
    except socket.gaierror as error:
        raise NetworkError(
            f"cannot resolve host {address.host!r}: {error.strerror}",
            hint="check the name, or give its IP address",
        ) from error
    except TimeoutError as error:
        raise NetworkError(
            f"no answer from a leader at {address} within {timeout_s:g} s", hint="check address and firewall"
        ) from error
    except (OSError, UnicodeError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise NetworkError(
            f"no leader at {address}: {reason}", hint="start one with: capture-app leader"
        ) from error
    channel = Channel[Any](reader, writer, msgspec.json.Decoder(messages))
    channel.who = who
    return channel
