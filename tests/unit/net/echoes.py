"""A port on loopback that says back what it is told."""

from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from typing import Any, TypeVar

import msgspec

from capture_app.common.address import Address
from capture_app.net.channel import Channel
from capture_app.net.server import TransferServer, bind_port


class Ping(msgspec.Struct, frozen=True, tag="ping"):
    number: int


class Pong(msgspec.Struct, frozen=True, tag="pong"):
    number: int


M = TypeVar("M")
PING = msgspec.json.encode(Ping(1))
Serve = Callable[[Channel[Any]], Awaitable[None]]


@asynccontextmanager
async def serving(serve: Serve, messages: Any = Ping, **limits: Any) -> AsyncIterator[Address]:
    """A port whose streams are served like that, within these limits of a TransferServer."""
    datagrams, listening = bind_port("127.0.0.1", 0)
    server = TransferServer[Any](messages, serve, **limits)
    await server.start(listening)
    try:
        yield Address("127.0.0.1", listening.getsockname()[1])
    finally:
        await server.stop()
        datagrams.close()


async def received_from(channel: Channel[M]) -> tuple[M, bytes] | None:
    """The next message and its payload; None if the peer closed the stream."""
    message = await channel.receive_header()
    return None if message is None else (message, b"".join([chunk async for chunk in channel.payload()]))


async def echo(channel: Channel[Ping]) -> None:
    """Answer each message with its number and payload."""
    while (received := await received_from(channel)) is not None:
        message, payload = received
        await channel.send(Pong(message.number), payload[:1], payload[1:])
