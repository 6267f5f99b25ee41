"""Server of the monitor's page: messages and pictures of the feed to each monitor, and its orders."""

import asyncio
import contextlib
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Literal

import msgspec
from aiohttp import WSMsgType
from msgspec import Struct

from capture_app.common.errors import SimulshotError
from capture_app.common.tasks import end
from capture_app.monitor.feed import MonitorFeed
from capture_app.rig.rig_link import RigLink
from capture_app.rig.taking import TakePlan
from capture_app.web.admission import Admission
from capture_app.web.paired_page import ListeningPage, PageLink, PairedPage


class PageOrder(Struct, frozen=True):
    """Order of a monitor's page.

    seen    acknowledges a picture: the next one of the same key may be sent
    look    requests larger pictures of one camera; an empty name ends them
    open    shows a picture of the last take, by its key; empty: none
    take    takes pictures by a plan
    stop    stops the take that has not begun, or the recording
    """

    type: Literal["seen", "look", "open", "take", "stop"]
    picture: str = ""
    camera: str = ""
    plan: TakePlan = TakePlan()


_DECODER = msgspec.json.Decoder(PageOrder)


class MonitorPage(PairedPage):
    """Serves the page; any number of monitors share one feed."""

    def __init__(self, admission: Admission, feed: MonitorFeed) -> None:
        super().__init__(admission, Path(__file__).parent / "page")
        self._feed = feed

    async def serve_link(self, link: PageLink) -> None:
        """Send the feed to a monitor and obey its orders until its page closes the link."""
        async with self._feed.reader() as changed:
            monitor = _Monitor(link, self._feed, changed)
            sending = asyncio.create_task(monitor.send())
            try:
                async for message in link.socket:
                    if message.type is not WSMsgType.TEXT:
                        raise ValueError("a monitor sends text only")
                    try:
                        await monitor.obey(_DECODER.decode(message.data))
                    except SimulshotError as error:
                        refusal = {"type": "refused", "words": str(error)}
                        await link.send(msgspec.json.encode(refusal).decode())
            finally:
                await end(sending, *monitor.looking)


class _Monitor:
    """One open monitor page: what was sent to it, and the pictures that it has not acknowledged."""

    def __init__(self, link: PageLink, feed: MonitorFeed, changed: asyncio.Event) -> None:
        self._link, self._feed, self._changed = link, feed, changed
        self._texts: dict[str, str] = {}
        self._pictures: dict[str, bytes] = {}
        self._unacknowledged: set[str] = set()
        self._open = ""
        self.looking: set[asyncio.Task[None]] = set()
        """Task that requests larger pictures of one camera, if any."""

    async def send(self) -> None:
        """Send what changes, forever: of each camera the newest picture, once the last was acknowledged."""
        while True:
            await self._changed.wait()
            self._changed.clear()
            for kind, text in tuple(self._feed.texts.items()):
                if self._texts.get(kind) != text:
                    self._texts[kind] = text
                    await self._link.send(text)
            for key in tuple(self._feed.pictures):
                await self._send_picture(key)

    async def _send_picture(self, key: str) -> None:
        picture = self._feed.pictures.get(key)
        if picture is None or picture is self._pictures.get(key) or key in self._unacknowledged:
            return
        if key.startswith("live/") or key == self._open:
            self._pictures[key] = picture
            self._unacknowledged.add(key)
            name = key.encode()
            await self._link.send(bytes([len(name)]) + name + picture)

    async def obey(self, order: PageOrder) -> None:
        """Carry out an order of the monitor's page. Raises SimulshotError."""
        match order.type:
            case "seen":
                self._unacknowledged.discard(order.picture)
                self._changed.set()
            case "look":
                await end(*self.looking)
                self.looking.clear()
                if order.camera:
                    self.looking.add(asyncio.create_task(self._feed.look_closely(order.camera)))
            case "open":
                self._open = order.picture
                self._pictures.pop(order.picture, None)
                self._feed.request_picture(order.picture)
                self._changed.set()
            case "take":
                self._feed.take(order.plan)
            case "stop":
                await self._feed.stop()


@contextlib.asynccontextmanager
async def serving_monitor(link: RigLink, page: ListeningPage, *, is_local: bool) -> AsyncIterator[None]:
    """Serve the monitors of a rig while the block runs; `is_local`: it saves sessions on this machine."""
    feed = MonitorFeed(link, is_local=is_local)
    following = asyncio.create_task(feed.run())
    try:
        async with MonitorPage(page.admission, feed).serving(page.socket, page.tls, page.names):
            yield
    finally:
        await end(following)
