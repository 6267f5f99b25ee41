"""A stream of a leader without a socket: what its peer says, and what it was sent."""

import asyncio
from collections import deque
from collections.abc import AsyncIterator
from typing import Any

from capture_app.common.errors import NetworkError
from tests.waiting import until


class FakeStream:
    """As a `Channel`; the test says what the peer sends, and None for the end."""

    def __init__(self, machine: str = "machine") -> None:
        self.machine, self.unread = machine, 0
        self.sent: list[Any] = []
        self.payloads: list[bytes] = []
        self.is_aborted = self.is_broken = self.may_be_silent = False
        self._said: asyncio.Queue[tuple[Any, bytes]] = asyncio.Queue()
        self._left: deque[bytes] = deque()

    def say(self, message: Any, payload: bytes = b"") -> None:
        """Let the peer send this."""
        self._said.put_nowait((message, payload))

    def take(self) -> list[Any]:
        """What it was sent since the last call."""
        sent, self.sent = self.sent, []
        return sent

    async def is_read(self) -> None:
        """Wait until all that the peer has sent is processed."""
        await until(self._said.empty)
        await asyncio.sleep(0.01)

    async def receive_header(self) -> Any:
        message, payload = await self._said.get()
        self.unread, self._left = len(payload), deque([payload] if payload else [])
        return message

    async def payload(self) -> AsyncIterator[bytes]:
        while self._left:
            yield self._left.popleft()

    async def send(self, message: Any, *payload: bytes) -> None:
        if self.is_broken:
            raise NetworkError("the connection broke off")
        self.sent.append(message)
        self.payloads.extend(payload)

    def allow_silence(self) -> None:
        self.may_be_silent = True

    def abort(self) -> None:
        self.is_aborted = True
        self.say(None)
