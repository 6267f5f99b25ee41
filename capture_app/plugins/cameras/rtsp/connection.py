"""RTSP connection to an IP camera (RFC 2326), with packets interleaved between responses over TCP.

The packets are RTP and RTCP (RFC 3550), and carry access units of H.264 (RFC 6184) and H.265 (RFC 7798).
"""

import asyncio
import base64
import contextlib
import hashlib
import re
import secrets
import struct
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from urllib.parse import SplitResult, unquote, urljoin, urlsplit

from capture_app.common import system
from capture_app.common.errors import BadInputError, CameraError
from capture_app.common.text import printable

PORT, TIMEOUT_S = 554, 5.0
DISCONNECTED = (OSError, EOFError, ValueError)
"""Errors of reading from a camera that has disconnected or sends something other than RTSP."""
_MAX_BYTES = 1 << 18
_REFUSALS = {
    401: ("refuses the user name or the password", "write rtsp://USER:PASSWORD@HOST/PATH"),
    403: ("refuses access to that stream", "allow it in the camera's settings"),
    404: ("has no stream of that path", "its manual, or its page in a browser, has the path"),
    453: ("has no bandwidth for one more", "end another program that watches it"),
    461: ("does not send over TCP", "allow RTSP over TCP in the camera's settings"),
    503: ("is busy", "end another program that watches it"),
}
_START = b"\0\0\0\1"
MAX_UNIT_BYTES = 1 << 23
"""Largest coded frame; the largest ones of 8K cameras have half of it."""


def reported_ticks(data: bytes) -> list[int]:
    """Return the RTP timestamps (32 bits) in the sender reports of a compound RTCP packet.

    The camera's wall clock in the same reports is not used: it may be wrong by years.
    """
    units, at = [], 0
    while at + 4 <= len(data):
        kind, words = struct.unpack_from(">xBH", data, at)
        if kind == 200 and at + 20 <= len(data):  # a sender report
            units.append(struct.unpack_from(">I", data, at + 16)[0])
        at += 4 * (words + 1)
    return units


@dataclass(frozen=True, slots=True)
class AccessUnit:
    """One coded frame, in the byte stream format that decoders take."""

    ticks: int
    """RTP timestamp, 32 bits."""
    arrival_ns: int
    """Arrival time of its first packet."""
    data: bytes
    whole: bool
    """Whether no packet is missing, in it or just before it."""


class AccessUnits:
    """Assembler of access units (coded frames) from the RTP packets of one stream."""

    def __init__(self, codec: str, payload_type: int) -> None:
        """Create an assembler; `codec` is h264 or hevc."""
        self._is_hevc, self._payload_type = codec == "hevc", payload_type
        self._next: int | None = None
        self._ticks = self._arrival_ns = 0
        self._data, self._whole = bytearray(), True

    def add(self, packet: bytes, arrival_ns: int) -> list[AccessUnit]:
        """Add an RTP packet; return the access units that it completes.

        Raises CameraError for a unit of over MAX_UNIT_BYTES.
        """
        if len(packet) < 12 or packet[0] >> 6 != 2 or packet[1] & 0x7F != self._payload_type:
            return []
        sequence, ticks = struct.unpack_from(">HI", packet, 2)
        done = self._finish() if ticks != self._ticks else []
        if not self._data:
            self._arrival_ns, self._ticks = arrival_ns, ticks
        if self._next not in (None, sequence):
            self._whole = False
        self._next = sequence + 1 & 0xFFFF
        try:
            for piece in self._pieces(packet_payload(packet)):
                self._data += piece
            if len(self._data) > MAX_UNIT_BYTES:
                raise CameraError(
                    f"sends a picture of over {MAX_UNIT_BYTES >> 20} MiB",
                    hint="choose a smaller picture or a lower bit rate in the camera's settings",
                )
        except (IndexError, struct.error):
            self._whole = False
        return [*done, *(self._finish() if packet[1] & 0x80 else [])]

    def _finish(self) -> list[AccessUnit]:
        if not self._data:
            return []
        done = AccessUnit(self._ticks, self._arrival_ns, bytes(self._data), self._whole)
        self._data, self._whole = bytearray(), True
        return [done]

    def _pieces(self, payload: bytes) -> Iterator[bytes]:
        """Yield the bytes that a payload adds: one unit, several in one packet, or a fragment of one."""
        head = 2 if self._is_hevc else 1
        kind = payload[0] >> 1 & 0x3F if self._is_hevc else payload[0] & 0x1F
        if kind == (48 if self._is_hevc else 24):
            at = head
            while at < len(payload):
                size = struct.unpack_from(">H", payload, at)[0]
                yield _START + payload[at + 2 : at + 2 + size]
                at += 2 + size
        elif kind == (49 if self._is_hevc else 28):
            fragment = payload[head]
            if fragment & 0x80 and self._is_hevc:
                yield _START + bytes((payload[0] & 0x81 | (fragment & 0x3F) << 1, payload[1]))
            elif fragment & 0x80:
                yield _START + bytes((payload[0] & 0xE0 | fragment & 0x1F,))
            yield payload[head + 1 :]
        else:
            yield _START + payload


def packet_payload(packet: bytes) -> bytes:
    """Return an RTP packet's payload. Raises struct.error or IndexError if it is cut off."""
    at = 12 + 4 * (packet[0] & 0x0F)
    if packet[0] & 0x10:
        at += 4 + 4 * struct.unpack_from(">H", packet, at + 2)[0]
    return packet[at : len(packet) - packet[-1] if packet[0] & 0x20 else None]


@dataclass(frozen=True, slots=True)
class VideoStream:
    """A camera's description of its video."""

    codec: str
    """h264 or hevc."""
    payload_type: int
    ticks_per_s: int
    parameter_sets: bytes
    """Parameter sets for the decoder, as a byte stream; may be empty."""
    fps: float | None
    control: str
    """Control URL of the stream, possibly relative."""


def parse_description(text: str) -> VideoStream:
    """Parse the video out of an SDP description (RFC 4566). Raises CameraError if it cannot be used."""
    section = re.search(r"^m=video \d+ \S+ (\d+).*?(?=^m=|\Z)", text, re.MULTILINE | re.DOTALL)
    if section is None:
        raise CameraError("describes no video", hint="check the path: this one may carry sound only")
    payload_type, lines = int(section[1]), section[0]

    def attribute(pattern: str) -> str:
        return next(iter(re.findall(rf"^a={pattern}", lines, re.MULTILINE)), "").strip()

    name, _, rate = attribute(rf"rtpmap:{payload_type} (\S+)").partition("/")
    if (codec := {"H264": "h264", "H265": "hevc"}.get(name.upper())) is None:
        raise CameraError(
            f"sends {printable(name) or 'its pictures'} in a format that is not read",
            hint="set it to H.264 or H.265",
        )
    sets = re.findall(r"sprop-[a-z]*-?(?:parameter-sets|vps|sps|pps)=([^;\s]+)", lines)
    fps = re.match(r"[\d.]+", attribute(r"framerate:(\S+)"))
    try:
        units = [base64.b64decode(unit) for one in sets for unit in one.split(",")]
        return VideoStream(
            codec,
            payload_type,
            ticks_per_s=int(rate.partition("/")[0] or 90_000),
            parameter_sets=b"".join(b"\0\0\0\1" + unit for unit in units if unit),
            fps=float(fps[0]) if fps else None,
            control=attribute(r"control:(\S+)"),
        )
    except ValueError as error:
        raise CameraError(
            "describes its video in a way that cannot be read",
            hint="try another path of it, or update its firmware",
        ) from error


class Connection:
    """Connection to one camera, which plays once it is open; errors name the camera by its host alone."""

    stream: VideoStream
    server: str
    """Name that the camera gives itself; may be empty."""

    def __init__(self, url: str, *, allows_basic: bool = False) -> None:
        """Parse a camera's address, with its password. Raises BadInputError if it cannot be read.

        With `allows_basic`, a camera that asks for it gets the password in clear text.
        """
        parts: SplitResult = urlsplit(url)
        try:
            self.host, self._port = parts.hostname or "", parts.port or PORT
        except ValueError:
            self.host = ""
        if not self.host:
            raise BadInputError(
                "the address of an IP camera cannot be read",
                hint="write rtsp://USER:PASSWORD@HOST/PATH, with %2F for / in a password and %2C for a comma",
            )
        self.round_trips_ns: deque[int] = deque(maxlen=100)
        """Round-trip times of the last answers to `ask`."""
        self.find_sound: Callable[[str], str] = lambda description: ""
        """Returns the control URL of the sound to receive on channels 2 and 3; empty for none."""
        self._allows_basic = allows_basic
        self._url = parts._replace(netloc=parts.netloc.rpartition("@")[2]).geturl()
        self._user, self._password = unquote(parts.username or ""), unquote(parts.password or "")
        self._reader: asyncio.StreamReader
        self._writer: asyncio.StreamWriter | None = None
        self._challenge = self._session = ""
        self._asked_ns: dict[int, int] = {}
        self._number = 0
        self._early: deque[tuple[int, bytes, int]] = deque()

    async def open(self) -> None:
        """Connect and start the stream. Raises CameraError."""
        try:
            async with asyncio.timeout(TIMEOUT_S):
                self._reader, self._writer = await asyncio.open_connection(
                    self.host, self._port, limit=_MAX_BYTES
                )
                await self._play()
        except CameraError as error:
            raise CameraError(f"{self.host} {error.what}", hint=error.hint) from error
        except TimeoutError as error:
            raise CameraError(
                f"{self.host} does not answer within {TIMEOUT_S:g} s",
                hint="check its address, power and network",
            ) from error
        except DISCONNECTED as error:
            raise CameraError(
                f"{self.host}, port {self._port}: no camera speaks RTSP there ({str(error)[:100]})",
                hint="check its address and its RTSP port, 554 by default",
            ) from error

    async def next_packet(self) -> tuple[int, bytes, int]:
        """Wait for a packet; return channel, bytes and monotonic arrival (ns). Raises one of DISCONNECTED."""
        while not self._early:
            await self._read()
        return self._early.popleft()

    def ask(self) -> None:
        """Send an OPTIONS request: it keeps the stream alive, and its answer measures the round trip."""
        self._asked_ns[self._number + 1] = system.monotonic_ns()
        self._send("OPTIONS", self._url)

    async def close(self) -> None:
        """End the session and close the connection. Calling it twice is harmless."""
        if self._writer is not None:
            with contextlib.suppress(OSError, TimeoutError):
                if self._session:
                    self._send("TEARDOWN", self._url)
                writer, self._writer = self._writer, None
                writer.close()
                async with asyncio.timeout(1.0):
                    await writer.wait_closed()

    async def _play(self) -> None:
        described, text = await self._ask("DESCRIBE", self._url, "Accept: application/sdp")
        self.server = printable(described.get("server", ""))
        self.stream = parse_description(text)
        base = described.get("content-base") or described.get("content-location") or self._url
        # Live servers end their base with a slash, others expect the client to append it.
        control = self.stream.control
        track = base if control in ("", "*") else urljoin(base.rstrip("/") + "/", control)
        await self._set_up(track, "interleaved=0-1")
        if sound := self.find_sound(text):
            await self._set_up(urljoin(base.rstrip("/") + "/", sound), "interleaved=2-3")
        await self._ask("PLAY", base, "Range: npt=0.000-")

    async def _set_up(self, track: str, channels: str) -> None:
        setup, _ = await self._ask("SETUP", track, f"Transport: RTP/AVP/TCP;unicast;{channels}")
        self._session = setup.get("session", "").partition(";")[0]
        if channels not in setup.get("transport", "").replace(" ", ""):
            raise CameraError(
                "does not send over TCP", hint="allow RTP over TCP (interleaved) in its settings"
            )

    async def _ask(self, method: str, url: str, *headers: str) -> tuple[dict[str, str], str]:
        """Return the response: first header of each name, and body. Raises CameraError for a refusal."""
        for _ in range(2):
            self._send(method, url, *headers)
            while (answer := await self._read()) is None:
                if len(self._early) > 256:
                    raise EOFError("it sends packets instead of an answer")
            status, fields, body = answer
            if status != 401 or not self._user:
                break
            challenges = [value for key, value in fields if key == "www-authenticate"]
            self._challenge = max(challenges, key=lambda one: one.lower().startswith("digest"), default="")
            if self._challenge.lower().startswith("basic") and not self._allows_basic:
                raise CameraError(
                    "asks for the password in clear text, which anyone in the network can read",
                    hint="set it to digest authentication, or append ,basic=yes to send the password anyway",
                )
        if status != 200:
            what, hint = _REFUSALS.get(status, (f"refuses {method} with {status}", ""))
            raise CameraError(what, hint=hint)
        return dict(reversed(fields)), body

    def _send(self, method: str, url: str, *headers: str) -> None:
        if self._writer is not None:
            self._number += 1
            lines = [f"{method} {url} RTSP/1.0", f"CSeq: {self._number}", "User-Agent: simulshot", *headers]
            if self._session:
                lines.append(f"Session: {self._session}")
            if self._challenge:
                answer = answer_challenge(self._challenge, method, url, self._user, self._password)
                lines.append(f"Authorization: {answer}")
            self._writer.write("\r\n".join([*lines, "", ""]).encode())

    async def _read(self) -> tuple[int, list[tuple[str, str]], str] | None:
        """Queue a packet, or return a response's status, headers and body.

        Requests from the camera need no answer here.
        """
        first = await self._reader.readexactly(1)
        if first == b"$":
            head = await self._reader.readexactly(3)
            arrival_ns = system.monotonic_ns()
            channel, size = struct.unpack(">BH", head)
            self._early.append((channel, await self._reader.readexactly(size), arrival_ns))
            return None
        if first in b"\r\n":
            return None
        try:
            text = (first + await self._reader.readuntil(b"\r\n\r\n")).decode("latin-1")
        except asyncio.LimitOverrunError as error:
            raise EOFError("it sends something else") from error
        came_ns = system.monotonic_ns()
        status, *lines = text.split("\r\n")
        if "RTSP/" not in status:
            raise EOFError("it speaks something else")
        pairs = (line.partition(":") for line in lines if ":" in line)
        headers = [(key.strip().lower(), value.strip()) for key, _, value in pairs]
        size = min(int(dict(headers).get("content-length", 0)), _MAX_BYTES)
        body = (await self._reader.readexactly(size)).decode("utf-8", "replace").replace("\r", "")
        if (status_line := re.match(r"RTSP/1\.\d (\d{3})", status)) is None:
            return None
        if asked_ns := self._asked_ns.pop(int(dict(headers).get("cseq") or 0), 0):
            self.round_trips_ns.append(came_ns - asked_ns)
        return int(status_line[1]), headers, body


def answer_challenge(challenge: str, method: str, url: str, user: str, password: str) -> str:
    """Return an Authorization header for a challenge: digest (RFC 7616) or basic (RFC 7617).

    Raises CameraError for an unknown scheme.
    """
    if challenge.lower().startswith("basic"):
        return "Basic " + base64.b64encode(f"{user}:{password}".encode()).decode()
    pairs = re.findall(r'(\w+)\s*=\s*(?:"([^"]*)"|([^\s,]+))', challenge)
    fields = {key.lower(): quoted or plain for key, quoted, plain in pairs}
    algorithm = fields.get("algorithm", "MD5")
    name = {"MD5": "md5", "SHA-256": "sha256"}.get(algorithm.upper())
    if name is None:
        raise CameraError(f"asks for a password by {printable(algorithm)[:20]}", hint="set it to digest")

    def digest(*parts: str) -> str:
        return hashlib.new(name, ":".join(parts).encode(), usedforsecurity=False).hexdigest()

    realm, nonce, own = fields.get("realm", ""), fields.get("nonce", ""), secrets.token_hex(8)
    said = {"username": user, "realm": realm, "nonce": nonce, "uri": url}
    said |= {"opaque": fields["opaque"]} if "opaque" in fields else {}
    once: tuple[str, ...] = ()
    text = f"algorithm={algorithm}"
    if "auth" in fields.get("qop", "").split(","):
        once, text = ("00000001", own, "auth"), f'{text}, qop=auth, nc=00000001, cnonce="{own}"'
    said["response"] = digest(digest(user, realm, password), nonce, *once, digest(method, url))
    quoted = ", ".join(f'{key}="{value}"' for key, value in said.items())
    return f"Digest {quoted}, {text}"
