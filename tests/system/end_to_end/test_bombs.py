"""What can be sent to fill the memory: each meets a process of its own, and takes under 200 MB."""

import asyncio
import hashlib
import os
import resource
import socket
import ssl
import struct
import sys
import tempfile
from collections.abc import AsyncIterator, Callable, Coroutine
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any
from urllib.parse import SplitResult, urlsplit

import cv2
import numpy as np
import pytest
from msgspec.structs import replace

from capture_app.common.errors import CameraError
from capture_app.node.burst.burst_session import BurstSession
from capture_app.plugins.cameras.rtsp import rtsp_camera
from capture_app.protocol.messages import ImageBatch
from capture_app.session.format.manifest import CameraRecord
from capture_app.session.reading.decoding import MAX_SENT_PIXELS, decode_preview
from capture_app.session.writing.session_writer import SessionWriter
from capture_app.sync.rig.frame_selection import Burst
from tests.facts import make_facts
from tests.images import small_jpeg
from tests.unit.companions.importing.test_bombs import png
from tests.unit.companions.phones.places import serving
from tests.unit.node.bursts import DISK, INSTANTS_NS, PERIOD_NS, report, upload
from tests.waiting import SLOW_PATIENCE_S, until

MAX_MB = 200
SIDE = 4096
CONNECTIONS = 4_000


def peak_mb() -> int:
    """The most memory that this process has taken until now."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024


# Pictures

PROGRESSIVE = f"""
import cv2, numpy as np, sys
options = cv2.IMWRITE_JPEG_PROGRESSIVE, 1, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, 0x111111
sys.stdout.buffer.write(cv2.imencode(".jpg", np.zeros(({SIDE}, {SIDE}, 3), np.uint8), options)[1])
"""


async def huge_png(_: int) -> None:
    assert decode_preview(png(16384, 16384)) is None


async def huge_jpeg(_: int) -> None:
    """A picture of a phone whose header claims 30000 x 30000 pixels."""
    small: bytes = cv2.imencode(".jpg", np.zeros((64, 64, 3), np.uint8))[1].tobytes()
    place = small.index(b"\xff\xc0") + 5
    assert decode_preview(small[:place] + struct.pack(">HH", 30_000, 30_000) + small[place + 4 :]) is None


async def largest_jpeg(_: int) -> None:
    """The largest one that is decoded, of the kind that takes most: progressive, with all of its colours."""
    made = await asyncio.create_subprocess_exec(
        sys.executable, "-c", PROGRESSIVE, stdout=asyncio.subprocess.PIPE
    )
    data = (await made.communicate())[0]
    assert SIDE * SIDE == MAX_SENT_PIXELS
    assert decode_preview(data) is not None


# IP cameras: this test's process is the camera


async def stream(port: int) -> None:
    """Follow an IP camera until it is given up."""
    camera = rtsp_camera.RtspCamera(f"rtsp://127.0.0.1:{port}/live", reports_s=0.1)
    failed = asyncio.Event()
    with suppress(CameraError):
        await camera.start(lambda frame: None, lambda error: failed.set())
        await failed.wait()
    await camera.stop()


def packet(number: int, size: int, *, last: bool) -> bytes:
    data = struct.pack(
        ">BBHII", 0x80, 96 | (0x80 if last else 0), number & 0xFFFF, 0 if not last else number, 7
    )
    data += b"\x65" + os.urandom(64) * (size // 64)
    return struct.pack(">cBH", b"$", 0, len(data)) + data


async def flood(reader: asyncio.StreamReader, writer: asyncio.StreamWriter, kind: str) -> None:
    description = "v=0\r\nm=video 0 RTP/AVP 96\r\na=rtpmap:96 H264/90000\r\na=control:track1\r\n"
    transport = "Transport: RTP/AVP/TCP;unicast;interleaved=0-1\r\nSession: 4711\r\n"
    with suppress(OSError, asyncio.IncompleteReadError):
        for number in range(1, 4):
            await reader.readuntil(b"\r\n\r\n")
            if kind == "before the first answer":
                break
            body = description if number == 1 else ""
            head = f"RTSP/1.0 200 OK\r\nCSeq: {number}\r\n{transport}Content-Length: {len(body)}\r\n\r\n"
            writer.write((head + body).encode())
        for number in range(1, 40_000):
            last = kind == "large pictures" and number % 120 == 0
            writer.write(packet(number, 60_000, last=last))
            await writer.drain()
    writer.transport.abort()


# Phones


async def phones(_: int) -> None:
    """A gateway of phones, until the test has connected."""
    allow_files()
    with tempfile.TemporaryDirectory() as folder:
        async with serving(Path(folder)) as place:
            print(place.url, flush=True)
            await asyncio.to_thread(sys.stdin.readline)


# Images of a burst


async def truths(_: int) -> None:
    """A simulated camera sends as much ground truth with each of its images as is taken."""
    facts, truth = make_facts(width=3840, height=2160), bytes(16 << 20)
    whole = small_jpeg(truth, 3840, 2160)
    instants_ns = tuple(INSTANTS_NS[0] + PERIOD_NS * n for n in range(64))
    burst = Burst(1, instants_ns, PERIOD_NS, instants_ns[0], ("a",))

    async def payload(data: bytes) -> AsyncIterator[bytes]:
        for at in range(0, len(data), 1 << 16):
            yield data[at : at + (1 << 16)]

    with tempfile.TemporaryDirectory() as folder:
        session = BurstSession.begin(burst, {"a": facts}, SessionWriter.create(Path(folder), "b"), DISK)
        record = CameraRecord(name="a", facts=facts)
        await session.accept_report(report("a", *range(64)).with_plan(camera=record), now_ns=0)
        saved = []
        for instant in range(64):
            image = upload("a", instant)
            size = replace(image.record, bytes=len(whole), sha256=hashlib.sha256(whole).hexdigest())
            coming = replace(image, record=size, truth_bytes=len(truth), true_ns=1)
            saved.append(await session.take(ImageBatch(images=(coming,)), payload(whole + truth), 0))
        await asyncio.gather(*saved)
        await until(session.finished.is_set, seconds=SLOW_PATIENCE_S)


BOMBS: dict[str, Callable[[int], Coroutine[Any, Any, None]]] = {
    of.__name__: of for of in (huge_png, huge_jpeg, largest_jpeg, stream, phones, truths)
}


def suffer(name: str, argument: str) -> None:
    """In a process of its own: meet one of them, and print what it took."""
    small = cv2.imencode(".jpg", np.zeros((64, 64, 3), np.uint8))[1].tobytes()
    assert decode_preview(small) is not None
    rtsp_camera.load_av()
    before = peak_mb()
    asyncio.run(BOMBS[name](int(argument)))
    print(peak_mb() - before, flush=True)


async def begin(name: str, argument: int = 0) -> asyncio.subprocess.Process:
    code = f"from tests.system.end_to_end.test_bombs import suffer; suffer({name!r}, '{argument}')"
    pipe = asyncio.subprocess.PIPE
    return await asyncio.create_subprocess_exec(sys.executable, "-c", code, stdin=pipe, stdout=pipe)


async def taken_mb(process: asyncio.subprocess.Process, what: str) -> int:
    async with asyncio.timeout(SLOW_PATIENCE_S):
        printed, _ = await process.communicate(b"\n")
    assert process.returncode == 0
    taken = int(printed.split()[-1])
    print(f"{what}: {taken} MB")
    return taken


@pytest.mark.parametrize("name", ["huge_png", "huge_jpeg", "largest_jpeg", "truths"])
async def test_a_picture_or_truth_takes_little_memory(name: str) -> None:
    assert await taken_mb(await begin(name), name) < MAX_MB


@pytest.mark.parametrize(
    "kind", ["before the first answer", "without an end of the picture", "large pictures"]
)
async def test_an_ip_camera_that_floods_takes_little_memory(kind: str) -> None:
    server = await asyncio.start_server(lambda reader, writer: flood(reader, writer, kind), "127.0.0.1", 0)
    async with server:
        process = await begin("stream", server.sockets[0].getsockname()[1])
        assert await taken_mb(process, f"packets {kind}") < MAX_MB


def allow_files() -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, min(hard, 3 * CONNECTIONS)), hard))


def connect_idly(stack: ExitStack, where: SplitResult, *, speaks_tls: bool) -> int:
    """Open connections that say nothing, or nothing after TLS; return how many were accepted."""
    tls = ssl.create_default_context()
    tls.check_hostname, tls.verify_mode = False, ssl.CERT_NONE
    opened = 0
    for _ in range(CONNECTIONS // 4 if speaks_tls else CONNECTIONS):
        with suppress(OSError):
            connection = socket.create_connection((where.hostname, where.port), timeout=10)
            stack.callback(connection.close)
            if speaks_tls:
                stack.callback(tls.wrap_socket(connection).close)
            opened += 1
    return opened


@pytest.mark.parametrize("speaks_tls", [False, True])
async def test_idle_connections_at_the_phones_port_take_little_memory(speaks_tls: bool) -> None:
    process = await begin("phones")
    assert process.stdout is not None
    where = urlsplit((await process.stdout.readline()).decode().strip())
    allow_files()
    with ExitStack() as stack:
        opened = await asyncio.to_thread(connect_idly, stack, where, speaks_tls=speaks_tls)
        what = f"{opened} idle connections{' that speak TLS' if speaks_tls else ''}"
        assert await taken_mb(process, what) < MAX_MB
