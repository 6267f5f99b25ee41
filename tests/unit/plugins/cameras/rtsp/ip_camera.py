"""An IP camera that exists only in tests, written after RFC 2326, 3550 and 6184: what it sends and when.

Its clocks may be wrong in any way, its stream is that of libx264, and each picture shows its number.
"""

import asyncio
import base64
import contextlib
import hashlib
import re
import struct
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cache
from itertools import count

import av
import numpy as np

from capture_app.cameras.frames import FramePicture

FPS, WIDTH, HEIGHT = 25, 160, 96
GOP = 5
PAYLOAD_TYPE = 96
NTP_UNIX_S = 2_208_988_800
MAX_BYTES = 300
"""Small packets, so that pictures come in fragments."""


@cache
def coded_pictures(codec: str, count: int = 50) -> list[list[bytes]]:
    """The units of each picture of a stream that can be repeated; its brightness tells its number."""
    stream = av.CodecContext.create({"H264": "libx264", "H265": "libx265"}[codec], "w")
    assert isinstance(stream, av.VideoCodecContext)
    stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
    stream.time_base, stream.framerate, stream.gop_size = Fraction(1, FPS), Fraction(FPS), GOP
    quiet = {"x265-params": "log-level=none:keyint=5:bframes=0"} if codec == "H265" else {}
    stream.options = {"preset": "ultrafast", "tune": "zerolatency", **quiet}
    packets = []
    for number in range(count):
        picture = np.full((HEIGHT, WIDTH, 3), 40 + 4 * number, np.uint8)
        frame = av.VideoFrame.from_ndarray(picture, "bgr24")
        frame.pts = number
        packets += stream.encode(frame)
    packets += stream.encode(None)
    return [[unit for unit in re.split(rb"\x00?\x00\x00\x01", bytes(packet)) if unit] for packet in packets]


@dataclass
class IpCamera:
    """How it behaves; may be changed while it runs."""

    codec: str = "H264"
    fps: int = FPS
    wall_error_s: float = 0.0
    """Its wall clock minus the true one."""
    rate_ppm: float = 0.0
    """Of all its clocks."""
    report_every_s: float | None = 0.2
    """None: it sends no sender reports."""
    reports_last_frame: bool = False
    """Its reports repeat the timestamp of the last frame, which was some time ago."""
    encoding_s: float = 0.08
    """From a picture's timestamp to its first packet."""
    login: tuple[str, str] | None = None
    algorithm: str = "MD5"
    basic_only: bool = False
    """It asks for the password in clear text."""
    seen_logins: list[str] = field(default_factory=list)
    """The Authorization headers that it was sent."""
    floods: bool = False
    """It sends packets instead of its first answer."""
    status: int = 200
    """What it answers to PLAY."""
    is_silent: bool = False
    """It plays and sends nothing."""
    loses: set[int] = field(default_factory=set)
    """Numbers of packets that it does not send."""
    offers: str | None = None
    """Another name of the codec than that of what it sends."""
    tells_time: bool = True
    """Its pictures have timestamps of their own."""
    report_jump_s: float = 0.0
    """What the clock of its reports is off that of its frames."""
    max_late_s: float = 0.0
    """How late it sent a picture at most, on a busy machine."""
    sound: str = "8"
    """Payload type of its sound, which clicks at whole seconds of the true time: A-law is 8, mu-law 0."""
    sound_delay_s: float = 0.06
    """From the end of a packet's samples to its sending."""
    true_ns: dict[int, list[int]] = field(default_factory=dict)
    """When each picture was, by its number, each time, in the host's monotonic clock."""
    tracks: list[str] = field(default_factory=list)
    """The tracks that were set up."""
    asked: list[str] = field(default_factory=list)
    """The methods that it was asked."""
    port: int = 0
    _writers: list[asyncio.StreamWriter] = field(default_factory=list)
    _sent: int = 0

    @asynccontextmanager
    async def running(self) -> AsyncIterator["IpCamera"]:
        coded_pictures(self.codec)  # encoded once for all, which takes longer than an answer may
        server = await asyncio.start_server(self._serve, "127.0.0.1", self.port)
        self.port = server.sockets[0].getsockname()[1]
        try:
            yield self
        finally:
            server.close()
            self.hang_up()
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(2):
                    await server.wait_closed()

    def hang_up(self) -> None:
        for writer in self._writers:
            writer.transport.abort()
        self._writers.clear()

    def url(self, login: str = "") -> str:
        return f"rtsp://{login + '@' if login else ''}127.0.0.1:{self.port}/live"

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._writers.append(writer)
        playing: asyncio.Task[None] | None = None
        speaking: asyncio.Task[None] | None = None
        try:
            while True:
                head = (await reader.readuntil(b"\r\n\r\n")).decode()
                method, url, _ = head.split(" ", 2)
                number = re.search(r"CSeq: (\d+)", head)[1]
                self.asked.append(method)
                self.seen_logins += re.findall(r"Authorization: (.*)", head)
                while self.floods:
                    writer.write((b"$\0" + struct.pack(">H", 1400) + bytes(1400)) * 100)
                    await writer.drain()
                writer.write(self._answer(method, url, head, number))
                if method == "PLAY" and self.status == 200 and not self.is_silent:
                    playing = asyncio.create_task(self._play(writer))
                    if "track2" in self.tracks:
                        speaking = asyncio.create_task(self._speak(writer))
        except (asyncio.IncompleteReadError, asyncio.CancelledError, OSError):
            pass
        finally:
            for task in filter(None, (playing, speaking)):
                task.cancel()
            writer.close()

    def _answer(self, method: str, url: str, head: str, number: str) -> bytes:
        status, headers, body = 200, "", ""
        if self.login is not None and not self._knows(method, head):
            status = 401
            headers = (
                'WWW-Authenticate: Basic realm="IP camera"\r\n'
                f'WWW-Authenticate: Digest realm="IP camera", nonce="8f2a", algorithm={self.algorithm}\r\n'
            )
            if self.basic_only:
                headers = headers.partition("\r\n")[0] + "\r\n"
        elif method == "DESCRIBE":
            headers, body = f"Content-Base: {url}/\r\nServer: Tests/1\r\n", self._description()
        elif method == "SETUP":
            self.tracks.append(url.rpartition("/")[2])
            channels = re.search(r"interleaved=\d-\d", head)[0]
            headers = f"Transport: RTP/AVP/TCP;unicast;{channels}\r\nSession: 4711;timeout=60\r\n"
        elif method == "PLAY":
            status = self.status
        head = f"RTSP/1.0 {status} Reason\r\nCSeq: {number}\r\n{headers}Content-Length: {len(body)}"
        return f"{head}\r\n\r\n{body}".encode()

    def _knows(self, method: str, head: str) -> bool:
        user, password = self.login
        told = dict(re.findall(r'(\w+)="([^"]*)"', head.partition("Authorization: Digest ")[2]))

        def digest(text: str) -> str:
            return hashlib.new(self.algorithm.replace("-", "").lower(), text.encode()).hexdigest()

        secret = digest(f"{user}:IP camera:{password}")
        return told.get("response") == digest(f"{secret}:8f2a:{digest(method + ':' + told.get('uri', ''))}")

    def _description(self) -> str:
        units = coded_pictures(self.codec)[0]
        sets = ""
        if self.codec == "H264":
            found = [base64.b64encode(unit).decode() for unit in units if unit[0] & 31 in (7, 8)]
            sets = f"; sprop-parameter-sets={','.join(found)}"
        return (
            "v=0\r\no=- 1 1 IN IP4 127.0.0.1\r\ns=test\r\nt=0 0\r\n"
            f"m=audio 0 RTP/AVP {self.sound}\r\na=control:track2\r\n"
            f"m=video 0 RTP/AVP {PAYLOAD_TYPE}\r\n"
            f"a=rtpmap:{PAYLOAD_TYPE} {self.offers or self.codec}/90000\r\n"
            f"a=fmtp:{PAYLOAD_TYPE} packetization-mode=1{sets}\r\n"
            f"a=framerate:{self.fps}.0\r\na=control:track1\r\n"
        )

    async def _play(self, writer: asyncio.StreamWriter) -> None:
        begun_ns, pace = time.monotonic_ns(), 1 + self.rate_ppm * 1e-6
        first_ticks = 2**32 - 90_000  # it wraps around after a second
        pictures, number, reported_ns = coded_pictures(self.codec), 0, 0
        last_ticks = first_ticks

        def ticks_at(true_ns: int) -> int:
            return (first_ticks + round((true_ns - begun_ns) * pace * 9e-5)) & 0xFFFFFFFF

        while not writer.is_closing():
            # Its own clock paces it.
            true_ns = begun_ns + round(number * 1e9 / self.fps / pace)
            await asyncio.sleep((true_ns - time.monotonic_ns()) / 1e9 + self.encoding_s)
            late_s = (time.monotonic_ns() - true_ns) / 1e9 - self.encoding_s
            self.max_late_s = max(self.max_late_s, late_s)
            self.true_ns.setdefault(number % len(pictures), []).append(true_ns)
            last_ticks = ticks_at(true_ns if self.tells_time else begun_ns)
            self._send_picture(writer, pictures[number % len(pictures)], last_ticks)
            number += 1
            now_ns = time.monotonic_ns()
            if self.report_every_s is not None and now_ns - reported_ns >= self.report_every_s * 1e9:
                reported_ns = now_ns
                await asyncio.sleep(0.003)
                now_ns = time.monotonic_ns()
                ticks = last_ticks if self.reports_last_frame else ticks_at(now_ns)
                self._send_report(writer, now_ns, ticks + round(self.report_jump_s * 90_000) & 0xFFFFFFFF)
            await writer.drain()

    async def _speak(self, writer: asyncio.StreamWriter) -> None:
        """Send packets of 20 ms; all but the clicks is the quietest code."""
        begun_ns, quiet, loud = time.monotonic_ns(), *((0xD5, 0xAA) if self.sound == "8" else (0xFF, 0x80))
        step_ns = 1e9 / (8000 * (1 + self.rate_ppm * 1e-6))
        for number in count():
            since_ns = np.arange(160 * number, 160 * number + 161) * step_ns
            at_ns = begun_ns + round(since_ns[-1])
            await asyncio.sleep((at_ns - time.monotonic_ns()) / 1e9 + self.sound_delay_s)
            is_click = (begun_ns % 10**9 + since_ns[:-1]) % 1e9 < 4 * step_ns
            codes = np.where(is_click, loud, quiet).astype(np.uint8).tobytes()
            packet = struct.pack(">BBHII", 0x80, int(self.sound), number & 0xFFFF, 160 * number, 8) + codes
            writer.write(struct.pack(">cBH", b"$", 2, len(packet)) + packet)
            if self.report_every_s is not None and number % 10 == 0:
                now_ns = time.monotonic_ns()
                self._send_report(writer, now_ns, round((now_ns - begun_ns) / step_ns), channel=3)
            await writer.drain()

    def _send_report(
        self, writer: asyncio.StreamWriter, now_ns: int, ticks: int, *, channel: int = 1
    ) -> None:
        wall_s = time.time() + self.wall_error_s + NTP_UNIX_S
        whole = int(wall_s)
        body = struct.pack(">IIIIII", 7, whole & 0xFFFFFFFF, int((wall_s - whole) * 2**32), ticks, 0, 0)
        report = struct.pack(">BBH", 0x80, 200, 6) + body
        name = struct.pack(">BBHI", 0x81, 202, 2, 7) + b"\1\2ab"
        writer.write(struct.pack(">cBH", b"$", channel, len(report + name)) + report + name)

    def _send_picture(self, writer: asyncio.StreamWriter, units: list[bytes], ticks: int) -> None:
        payloads = [payload for unit in units for payload in self._payloads(unit)]
        for index, payload in enumerate(payloads):
            self._sent += 1
            last = 0x80 if index == len(payloads) - 1 else 0
            packet = struct.pack(">BBHII", 0x80, PAYLOAD_TYPE | last, self._sent & 0xFFFF, ticks, 7) + payload
            if self._sent not in self.loses:
                writer.write(struct.pack(">cBH", b"$", 0, len(packet)) + packet)

    def _payloads(self, unit: bytes) -> list[bytes]:
        if len(unit) <= MAX_BYTES:
            return [unit]
        head = 1 if self.codec == "H264" else 2
        parts = [unit[at : at + MAX_BYTES] for at in range(head, len(unit), MAX_BYTES)]
        found = []
        for index, part in enumerate(parts):
            marks = (0x80 if index == 0 else 0) | (0x40 if index == len(parts) - 1 else 0)
            if self.codec == "H264":
                found.append(bytes((unit[0] & 0xE0 | 28, marks | unit[0] & 0x1F)) + part)
            else:
                kind = unit[0] >> 1 & 0x3F
                found.append(bytes((unit[0] & 0x81 | 49 << 1, unit[1], marks | kind)) + part)
        return found


def number_shown(picture: FramePicture) -> int:
    """The number of a picture, by its brightness, which coding makes a little darker."""
    return round((float(picture.reduced(WIDTH).mean()) - 37.5) / 4)
