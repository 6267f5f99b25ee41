"""Streams between machines that know each other, and those that do not; each machine is a folder here."""

import asyncio
import socket
from contextlib import ExitStack, suppress

from capture_app.net.server import MAX_SILENT
from capture_app.trust.trust import Trust
from tests.unit.net.echoes import Pong
from tests.unit.trust.test_streams import (
    ask,
    leader,  # noqa: F401 - a fixture
    served,
)


async def test_connections_that_show_nothing_keep_no_room_and_nobody_out(leader: Trust) -> None:
    loop = asyncio.get_running_loop()
    async with served(leader) as (address, _):
        with ExitStack() as held:
            silent = [held.enter_context(socket.socket()) for _ in range(150)]
            for stranger in silent:
                stranger.setblocking(False)
                await loop.sock_connect(stranger, tuple(address))
            assert await ask(address, leader) == (Pong(7), b"picture")
            for stranger in silent[: 150 - MAX_SILENT]:
                with suppress(ConnectionResetError):
                    async with asyncio.timeout(60):
                        assert await loop.sock_recv(stranger, 100) == b""
