"""Streams of the virtual network offer all that asyncio and its TLS ask of a transport."""

import asyncio
import contextlib
import socket
import ssl
from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest

from capture_app.trust.trust import Trust
from tests.virtual.network import MemoryTransport
from tests.virtual.world import World

PORT = 47000
Accept = Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]]


def _run(accept: Accept, client: Callable[[str], Awaitable[None]]) -> list[str]:
    """Run a server and a client on two machines, and return the errors that nobody handled."""
    world = World(1)
    host = world.network.host("server")
    world.network.host("client")

    async def serve() -> None:
        listening = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        listening.bind(("0.0.0.0", PORT))
        await asyncio.start_server(accept, sock=listening)
        await asyncio.Event().wait()

    async def connect() -> None:
        await asyncio.sleep(1)
        await client(host)

    async def evening() -> None:
        world.start("server", "server", serve)
        world.start("client", "client", connect)
        await asyncio.sleep(60)
        await world.kill("server")
        await world.kill("client")

    try:
        with world.entered():
            world.run(evening())
    finally:
        world.disks.remove()
    return world.failures


def test_the_transport_implements_every_method_that_asyncio_declares() -> None:
    declared = {name for of in asyncio.Transport.__mro__ for name in vars(of) if not name.startswith("_")}
    # TLS calls this one too: where a handshake fails, and from Python 3.13 on wherever it aborts.
    assert {*declared, "_force_close"} <= {*vars(MemoryTransport)}


def test_write_buffer_limits_are_those_of_asyncio() -> None:
    transport = MemoryTransport.__new__(MemoryTransport)
    for asked, limits in (
        ({}, (16 << 10, 64 << 10)),
        ({"high": 100}, (25, 100)),
        ({"low": 100}, (100, 400)),
        ({"high": 0}, (0, 0)),
    ):
        transport.set_write_buffer_limits(**asked)
        assert transport.get_write_buffer_limits() == limits


def test_a_client_that_is_answered_in_plain_text_sees_a_failed_handshake() -> None:
    seen: list[type[BaseException]] = []

    async def accept(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(b"HTTP/1.0 400 Bad request\r\n\r\n")
        await asyncio.sleep(5)
        writer.close()

    async def client(host: str) -> None:
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        try:
            await asyncio.open_connection(host, PORT, ssl=context)
        except OSError as error:
            seen.append(type(error))

    failures = _run(accept, client)
    assert len(seen) == 1
    assert issubclass(seen[0], ssl.SSLError)
    # asyncio itself logs a handshake that fails.
    assert all("SSL handshake failed" in failure for failure in failures)


@pytest.mark.parametrize("is_server", [False, True])
def test_an_aborted_tls_stream_is_reset_at_both_ends(is_server: bool, tmp_path: Path) -> None:
    server_trust, client_trust = Trust(tmp_path / "server"), Trust(tmp_path / "client")
    ends: list[str] = []

    async def talk(reader: asyncio.StreamReader, writer: asyncio.StreamWriter, *, aborts: bool) -> None:
        writer.write(b"hello")
        assert await reader.readexactly(5) == b"hello"
        if aborts:
            writer.transport.abort()
        try:
            rest = await reader.read()
        except ConnectionResetError:
            ends.append("reset")
        else:
            ends.append(f"closed after {len(rest)} bytes")
        writer.close()
        with contextlib.suppress(OSError):
            await writer.wait_closed()

    async def accept(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        context = server_trust.server_context()
        assert context is not None
        await writer.start_tls(context)
        await talk(reader, writer, aborts=is_server)

    async def client(host: str) -> None:
        context = client_trust.client_context(as_unknown=True)
        reader, writer = await asyncio.open_connection(host, PORT, ssl=context)
        await talk(reader, writer, aborts=not is_server)

    assert _run(accept, client) == []
    assert sorted(ends) == ["closed after 0 bytes", "reset"]
