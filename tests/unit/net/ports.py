"""Ports of the loopback, where something answers or nothing does."""

import asyncio
import socket
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from capture_app.common.address import Address
from capture_app.sync.wire.codec import VERSION, version_answer


class Answering(asyncio.DatagramProtocol):
    """Answers a question for the version, as an end of `version` does, from the `first`-th on."""

    def __init__(self, version: int, first: int) -> None:
        self._version, self._left = version, first
        self.came = 0

    def connection_made(self, transport: asyncio.DatagramTransport) -> None:  # type: ignore[override]
        self._transport = transport

    def datagram_received(self, data: bytes, where: tuple[str, int]) -> None:
        self.came += 1
        self._left -= 1
        answer = version_answer(data)
        if answer is not None and self._left <= 0:
            # What strangers send meanwhile is no answer.
            self._transport.sendto(b"noise", where)
            self._transport.sendto(answer[:4] + bytes(8), where)
            self._transport.sendto(answer[:2] + bytes([self._version]) + answer[3:], where)


@asynccontextmanager
async def answering(version: int = VERSION, *, first: int = 1) -> AsyncIterator[Address]:
    loop = asyncio.get_running_loop()
    transport, _ = await loop.create_datagram_endpoint(
        lambda: Answering(version, first), local_addr=("127.0.0.1", 0)
    )
    yield Address("127.0.0.1", transport.get_extra_info("sockname")[1])
    transport.close()


def closed_port() -> Address:
    with socket.create_server(("127.0.0.1", 0)) as stream:
        return Address("127.0.0.1", stream.getsockname()[1])
