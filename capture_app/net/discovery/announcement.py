"""Tells the local network where a leader or a relay listens, and tells it again where that changes."""

import asyncio
import contextlib
import secrets
import socket
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Literal

from zeroconf import Error
from zeroconf.asyncio import AsyncServiceInfo, AsyncZeroconf

from capture_app import __version__
from capture_app.names import name_like
from capture_app.net.address import ANY_HOST
from capture_app.net.interfaces import own_hosts
from capture_app.sync.wire.version import VERSION
from capture_app.trust.trust import Trust

SERVICE = "_simulshot._udp.local."
LOOK_EVERY_S = 5.0
"""Between two looks at which addresses this machine has: a network may come up later, or change."""
GOODBYE_S = 1.0
MOST_LETTERS = 50
"""Of a name: with the port it must be a label of DNS, of 63 bytes."""

Kind = Literal["leader", "relay"]


@asynccontextmanager
async def announced(
    host: str, port: int, kind: Kind, *, name: str | None = None, trust: Trust | None = None
) -> AsyncIterator[None]:
    """Announce what listens on `host` and `port` while the block runs, by `name`, else that of this machine.

    Its pin is that of `trust`, else of its user's; nodes that know it prefer it. One that only this machine
    can reach, or by IPv6 only, is not announced; a network that does not let it be announced only costs that.
    """
    own = trust or Trust.of_user()
    info = _service_info(port, kind, name, "" if own.is_open else own.identity.pin)
    task = asyncio.create_task(_keep_announced(host, info))
    try:
        yield
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


def announced_hosts(host: str) -> list[str]:
    """Return the IPv4 addresses at which other machines reach what listens on `host`."""
    if host in ANY_HOST:
        return sorted(own_hosts(socket.AF_INET))
    with contextlib.suppress(OSError):
        found = socket.getaddrinfo(host, None, socket.AF_INET, socket.SOCK_DGRAM)
        return sorted({str(where[0]) for *_, where in found if not str(where[0]).startswith("127.")})
    return []


def _service_info(port: int, kind: Kind, name: str | None, pin: str) -> AsyncServiceInfo:
    name = name or name_like(socket.gethostname().split(".")[0], "simulshot")
    label = f"{name[:MOST_LETTERS]}-{port}"
    return AsyncServiceInfo(
        SERVICE,
        f"{label}.{SERVICE}",
        port=port,
        properties={"version": __version__, "protocol": str(VERSION), "kind": kind, "pin": pin},
        # A host name of its own: that of this machine is its mDNS daemon's.
        server=f"simulshot-{secrets.token_hex(4)}.local.",
    )


async def _keep_announced(host: str, info: AsyncServiceInfo) -> None:
    hosts: list[str] = []
    responder: AsyncZeroconf | None = None
    try:
        while True:
            found = announced_hosts(host)
            if found != hosts:
                await _close(responder)
                hosts, responder = found, None
                if hosts:
                    responder = await _open(hosts, info)
                    # What could not be announced now is tried again.
                    hosts = hosts if responder is not None else []
            await asyncio.sleep(LOOK_EVERY_S)
    finally:
        await _close(responder)


async def _open(hosts: list[str], info: AsyncServiceInfo) -> AsyncZeroconf | None:
    responder = None
    try:
        responder = AsyncZeroconf(interfaces=hosts)
        info.addresses = [socket.inet_aton(host) for host in hosts]
        await (await responder.async_register_service(info, allow_name_change=True))
    except (Error, OSError, TimeoutError):
        await _close(responder)
        return None
    except asyncio.CancelledError:
        await _close(responder)
        raise
    return responder


async def _close(responder: AsyncZeroconf | None) -> None:
    if responder is not None:
        with contextlib.suppress(Error, OSError, TimeoutError):
            async with asyncio.timeout(GOODBYE_S):
                await responder.async_close()
