"""The server of phones on the leader's machine, as a process that ends with it."""

import asyncio
from pathlib import Path

import msgspec
from msgspec import Struct

from capture_app.errors import NetworkError
from capture_app.net.address import Address
from capture_app.node.child import Child
from capture_app.node.leader.news_log import NewsLog
from capture_app.node.wire.operating import PhoneInvited

START_TIMEOUT_S = 30.0
EVENT = "invitation"


class _Line(Struct, frozen=True):
    """A line of what it prints."""

    event: str
    url: str = ""
    fingerprint: str = ""
    good_for_s: int = 0


class LocalPhones:
    """Started when the first phone is invited, and again by the next invitation where it has ended."""

    def __init__(self, leader: Address, spool: Path, host: str, news: NewsLog) -> None:
        """`host` is where phones reach this machine."""
        self._leader, self._spool, self._host, self._news = leader, spool, host, news
        self._child: Child | None = None
        self._reading: asyncio.Task[None] | None = None
        self._invited: tuple[PhoneInvited, float] | None = None
        self._news_came = asyncio.Event()
        self._starting = asyncio.Lock()

    async def invitation(self) -> PhoneInvited:
        """Return the page of the next phone. Raises NetworkError, and what its server ended with."""
        async with self._starting:
            if self._child is None or self._child.process.returncode is not None:
                await self._start()
        if self._invited is None:
            raise NetworkError("the server of phones has not begun", hint="ask again in a moment")
        invited, until_s = self._invited
        left_s = max(0, round(until_s - asyncio.get_running_loop().time()))
        return msgspec.structs.replace(invited, good_for_s=left_s)

    async def close(self) -> None:
        """End it."""
        if self._reading is not None:
            self._reading.cancel()
        if self._child is not None:
            await self._child.stop()

    async def _start(self) -> None:
        self._invited = None
        self._news_came.clear()
        arguments = ("capture_app.cli", "phones", "--until-eof", "--json", "--host", self._host)
        where = ("--leader", str(self._leader), "--spool", str(self._spool))
        self._child = await Child.start("the server of phones", (*arguments, *where))
        self._reading = asyncio.create_task(self._read(self._child))
        try:
            async with asyncio.timeout(START_TIMEOUT_S):
                await self._news_came.wait()
        except TimeoutError:
            return
        if self._invited is None:
            await self._child.process.wait()
            raise await self._child.failure()

    async def _read(self, child: Child) -> None:
        assert child.process.stdout is not None
        async for raw in child.process.stdout:
            try:
                line = msgspec.json.decode(raw, type=_Line)
            except ValueError:
                continue
            if line.event == EVENT:
                until_s = asyncio.get_running_loop().time() + line.good_for_s
                told = PhoneInvited(url=line.url, fingerprint=line.fingerprint, good_for_s=line.good_for_s)
                self._invited = told, until_s
                self._news_came.set()
        if self._invited is not None:
            self._news.add("the server of phones has ended; invite a phone to start it again", level="error")
        self._news_came.set()
