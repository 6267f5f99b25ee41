"""A monitor of a rig of cheap cameras, in this process, on the loopback, over real TLS."""

import contextlib
import json
import ssl
import time
from collections.abc import AsyncGenerator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import aiohttp
import pytest

from capture_app.companions.monitor.monitor_page import serving_monitor
from capture_app.node.leader.leader_node import LeaderNode
from capture_app.rig.rig_link import RigLink
from capture_app.web import paired_page
from capture_app.web.admission import Admission
from capture_app.web.paired_page import ListeningPage
from tests.cheap_rig import rig_of
from tests.waiting import time_limit


@dataclass
class ServedMonitor:
    """A leader and the monitor of its rig."""

    leader: LeaderNode
    page: ListeningPage

    @property
    def base(self) -> str:
        return f"https://{self.page.address}/"

    async def url(self) -> str:
        """The page with the next device's code."""
        return (await self.page.invitation()).url


@contextlib.asynccontextmanager
async def monitored(folder: Path, cameras: int) -> AsyncGenerator[ServedMonitor, None]:
    """A rig and its monitor, until the block ends.

    Without the server's heartbeat: browsers answer it by themselves, `StandInMonitor` only while it hears.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(paired_page, "HEARTBEAT_S", None)
        async with _serving(folder, cameras) as served:
            yield served


@contextlib.asynccontextmanager
async def _serving(folder: Path, cameras: int) -> AsyncGenerator[ServedMonitor, None]:
    async with rig_of(cameras, folder / "sessions") as leader:
        page = ListeningPage(Admission(time.monotonic, "monitor"), "127.0.0.1", 0, 0)
        async with serving_monitor(RigLink(leader.own_address), page, is_local=True):
            yield ServedMonitor(leader, page)


class StandInMonitor:
    """What a page says and hears, without a browser; it acknowledges pictures only when told to."""

    def __init__(self, page: ListeningPage, key: str = "0" * 32) -> None:
        self._page, self._key = page, key
        self._base = f"https://{page.address}/"
        context = ssl.create_default_context()
        context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
        self.session = aiohttp.ClientSession(connector=aiohttp.TCPConnector(ssl=context))
        self.pictures: dict[str, list[bytes]] = {}
        self.said: dict[str, dict[str, Any]] = {}
        """Last message of each type."""
        self.link: aiohttp.ClientWebSocketResponse

    async def join(self, secret: str | None = None, **headers: str) -> tuple[int, dict[str, str]]:
        secret = self._page.admission.secret if secret is None else secret
        asked = {"secret": secret, "key": self._key, "name": ""}
        async with self.session.post(f"{self._base}join", json=asked, headers=headers) as answer:
            is_json = answer.content_type == "application/json"
            return answer.status, await answer.json() if is_json else {"words": await answer.text()}

    async def open(self) -> None:
        status, body = await self.join()
        assert status == 200, body
        self.link = await self.session.ws_connect(f"{self._base}link/{body['ticket']}")

    async def say(self, **order: Any) -> None:
        await self.link.send_str(json.dumps(order))

    async def hear(self) -> str:
        """Wait for the next message, and return its type, or the key of a picture."""
        async with time_limit("a message of the monitor"):
            message = await self.link.receive()
        if message.type is aiohttp.WSMsgType.TEXT:
            told = json.loads(message.data)
            self.said[told["type"]] = told
            return str(told["type"])
        assert message.type is aiohttp.WSMsgType.BINARY, message
        end = 1 + message.data[0]
        key = message.data[1:end].decode()
        self.pictures.setdefault(key, []).append(message.data[end:])
        return str(key)

    async def __aenter__(self) -> "StandInMonitor":
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.session.close()
