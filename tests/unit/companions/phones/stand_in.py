"""A phone without a browser: it says what a page says, with a clock of its own, over real TLS."""

import asyncio
import contextlib
import json
import secrets
import struct
import time
from itertools import count
from typing import Any

import aiohttp
import cv2
import numpy as np

from capture_app.common.host_clock import host_ns
from capture_app.plugins.cameras.sound.microphones import SimulatedSound

SAMPLES = 1920
PERIOD_US = 1e6 / 30
ARRIVAL_US = 300.0
"""Time from the start of a frame to its arrival in the page."""
WIDTH, HEIGHT = 320, 240


def jpeg_of(width: int, height: int) -> bytes:
    """A grey picture."""
    return cv2.imencode(".jpg", np.full((height, width, 3), 90, np.uint8))[1].tobytes()


JPEG = jpeg_of(WIDTH, HEIGHT)


class StandInPhone:
    """Joins a gateway by a page's address; its clock is `zero_us` behind, and its camera even."""

    def __init__(
        self, url: str, *, name: str = "left", key: str = "", zero_us: float = 5e9, phase_us: float = 7_000.0
    ) -> None:
        self.base, _, self.secret = url.partition("#")
        self.name = name
        self.key = key or secrets.token_hex(16)
        self.page = secrets.token_hex(8)
        self.restarts: list[float] = []
        self.states: list[str] = []
        self.asked = 0
        self.exposure_us = 20_000.0
        self._jpeg = JPEG
        self._zero_us = zero_us
        self._phase_us, self._stream, self._next = phase_us, 1, 0
        self._ring: dict[int, bytes] = {}
        self._session: aiohttp.ClientSession
        self._socket: Any = None
        self._links: list[aiohttp.ClientWebSocketResponse] = []
        self._tasks: list[asyncio.Task[None]] = []

    def now_us(self) -> float:
        return time.monotonic_ns() / 1000 - self._zero_us

    async def ask(self, **body: str) -> tuple[int, dict[str, Any]]:
        """Ask to be let in; the answer's status and body."""
        wanted = {"secret": self.secret, "key": self.key, "name": self.name, **body}
        async with self._session.post(f"{self.base}join", json=wanted, ssl=False) as answer:
            return answer.status, await answer.json()

    async def open(self) -> None:
        self._session = aiohttp.ClientSession()

    async def join(self) -> str:
        """Be let in, and link; the name that the camera got."""
        self._socket = await self.link()
        hello = {"type": "hello", "page": self.page, "resolution_us": 5.0, "user_agent": "Chrome/1 Android"}
        await self._socket.send_str(json.dumps(hello))
        self._tasks = [asyncio.create_task(self._listen()), asyncio.create_task(self._ping())]
        return self.given_name

    async def link(self) -> Any:
        """Be let in; the link, before its first words."""
        status, body = await self.ask()
        assert status == 200, body
        self.given_name = str(body["name"])
        link = await self._session.ws_connect(f"{self.base}link/{body['ticket']}", ssl=False)
        self._links.append(link)
        return link

    async def open_camera(self) -> None:
        opened = {"type": "opened", "width": WIDTH, "height": HEIGHT, "frame_rate": 30.0, "label": "back"}
        await self._socket.send_str(json.dumps(opened))
        await self._update_exposure()
        self._tasks.append(asyncio.create_task(self._shoot()))

    async def hear(self, sound: SimulatedSound) -> None:
        """Send a microphone's samples from now on; each arrives at the page 2 ms late."""

        async def send() -> None:
            for first in count(0, SAMPLES):
                late_s = (sound.true_ns(first + SAMPLES) - host_ns()) / 1e9 + 0.002
                await asyncio.sleep(max(0.0, late_s))
                told = struct.pack("<Bd", 5, self.now_us()) + sound.samples(first, SAMPLES)
                with contextlib.suppress(ConnectionError):
                    await self._socket.send_bytes(told)

        self._tasks.append(asyncio.create_task(send()))

    async def say(self, **message: Any) -> None:
        if message.get("type") == "opened":
            self._jpeg = jpeg_of(message["width"], message["height"])
        await self._socket.send_str(json.dumps(message))

    async def vanish(self) -> None:
        """Be gone without a word."""
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        await self._session.close()
        # The network is gone: nothing is said any more, and the connection is not left to the collector.
        await asyncio.gather(*(link.close() for link in self._links))

    @property
    def is_cut_off(self) -> bool:
        return bool(self._socket.closed)

    @property
    def close_code(self) -> int | None:
        code: int | None = self._socket.close_code
        return code

    async def _listen(self) -> None:
        async for message in self._socket:
            received_us = self.now_us()
            if message.type is aiohttp.WSMsgType.BINARY:
                _, number = struct.unpack("<BI", message.data)
                self._last = number, received_us
                continue
            said = json.loads(message.data)
            if said["type"] == "state":
                self.states.append(said["state"])
            elif said["type"] == "control":
                problem = "" if said["value"] != 1e9 else "the browser refuses it"
                if not problem:
                    self.exposure_us = said["value"] or 33_000.0
                await self._update_exposure(answers=said["number"], problem=problem)
            elif said["type"] == "restart":
                self.restarts.append(said["at_us"])
                self._stream += 1
                self._phase_us = said["at_us"] % PERIOD_US + 11_000.0
            else:
                self.asked += 1
                kind = 3 if said["type"] == "picture" else 4
                await self._socket.send_bytes(
                    struct.pack("<BI", kind, said["id"]) + self._ring.get(said["id"], b"")
                )

    async def _update_exposure(self, **answer: Any) -> None:
        limits = {"minimum": 100, "maximum": 2e9}
        exposure = {"control": "exposure", "unit": "µs", "value": self.exposure_us, **limits}
        await self.say(type="controls", controls=[{**exposure, "can_be_automatic": True}], **answer)

    async def _ping(self) -> None:
        self._last = 0xFFFFFFFF, 0.0
        number = 0
        while True:
            last, self._last = self._last, (0xFFFFFFFF, 0.0)
            await self._socket.send_bytes(struct.pack("<BIIdd", 1, number, *last, self.now_us()))
            number += 1
            await asyncio.sleep(0.01)

    async def _shoot(self) -> None:
        stream, at_us = 0, 0.0
        while True:
            if stream != self._stream:
                stream = self._stream
                at_us = self.now_us() // PERIOD_US * PERIOD_US + self._phase_us
            # However late this machine is, no frame is left out.
            at_us += PERIOD_US
            await asyncio.sleep((at_us - self.now_us()) / 1e6)
            if stream != self._stream:
                continue
            self._next += 1
            self._ring[self._next] = self._jpeg
            self._ring.pop(self._next - 200, None)
            # A phone is not late because this machine is: its frames arrive on time by its own clock.
            told = struct.pack("<BIIddd", 2, self._next, stream, at_us, at_us + ARRIVAL_US, float("nan"))
            with contextlib.suppress(ConnectionError):
                await self._socket.send_bytes(told)
