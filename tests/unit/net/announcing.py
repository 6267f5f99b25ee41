"""A program that announces leaders and relays, `KIND:PORT:NAME`, and answers at their ports.

One of a trust's folder is `KIND@FOLDER:PORT:NAME`; one of several leaders `KIND:PORT:NAME:HOST+HOST`.
A `silent-` one does not answer; a `strange-` one tells a version that would steer a terminal.
"""

import asyncio
import socket
import sys
from contextlib import AsyncExitStack
from pathlib import Path

from zeroconf.asyncio import AsyncServiceInfo, AsyncZeroconf

from capture_app.common.address import Address
from capture_app.net.discovery import SERVICE, Kind, announced
from capture_app.sync.wire.codec import version_answer
from capture_app.trust.trust import Trust
from tests.unit.net.machines import LEADER_HOST


class Answering(asyncio.DatagramProtocol):
    """Answers a question for the version."""

    def connection_made(self, transport: asyncio.DatagramTransport) -> None:  # type: ignore[override]
        self._transport = transport

    def datagram_received(self, data: bytes, where: tuple[str, int]) -> None:
        if answer := version_answer(data):
            self._transport.sendto(answer, where)


def strange_service(port: int, name: str) -> AsyncServiceInfo:
    told = {"version": "\x1b[2J\n" + 200 * "x", "kind": "?"}
    address = socket.inet_aton(LEADER_HOST)
    return AsyncServiceInfo(SERVICE, f"{name}.{SERVICE}", port, properties=told, addresses=[address])


async def announce_all(wanted: list[str]) -> None:
    loop = asyncio.get_running_loop()
    async with AsyncExitStack() as stack:
        for one in wanted:
            text, port, name, *hosts = one.split(":")
            among = [Address(host, int(port)) for names in hosts for host in names.split("+")]
            is_silent = text.startswith("silent-")
            trust = Trust(Path(text.partition("@")[2])) if "@" in text else Trust.open()
            text = text.partition("@")[0]
            kind: Kind = "relay" if text.endswith("relay") else "leader"
            if not is_silent:
                await loop.create_datagram_endpoint(Answering, local_addr=("0.0.0.0", int(port)))
            if text.startswith("strange-"):
                responder = await stack.enter_async_context(AsyncZeroconf(interfaces=[LEADER_HOST]))
                await (await responder.async_register_service(strange_service(int(port), name)))
            else:
                await stack.enter_async_context(
                    announced("0.0.0.0", int(port), kind, name=name, trust=trust, among=among)
                )
        print("announcing", flush=True)
        await loop.run_in_executor(None, sys.stdin.read)


if __name__ == "__main__":
    asyncio.run(announce_all(sys.argv[1:]))
