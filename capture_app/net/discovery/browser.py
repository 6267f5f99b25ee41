"""Who announces a leader or a relay in the local network."""

import asyncio
import contextlib
import socket
from dataclasses import dataclass
from typing import Self

from zeroconf import Error, IPVersion, ServiceStateChange, Zeroconf
from zeroconf.asyncio import AsyncServiceBrowser, AsyncServiceInfo, AsyncZeroconf

from capture_app.net.address import Address
from capture_app.net.discovery.announcement import SERVICE
from capture_app.net.interfaces import own_hosts
from capture_app.text import printable

MOST_LEADERS, MOST_ADDRESSES, MOST_LETTERS = 32, 16, 80
DETAILS_MS = 3000
"""How long to ask for the address of one that was heard of."""


@dataclass(frozen=True, slots=True)
class FoundLeader:
    """A leader or a relay as it is announced, by anybody; texts are printable."""

    name: str
    addresses: tuple[Address, ...]
    version: str
    """Of its simulshot."""
    is_relay: bool = False
    pin: str = ""
    """That it says it has; its streams have to prove it."""


class LeaderBrowser:
    """Listens for announcements; `async with LeaderBrowser()` begins, and ends with the block.

    Where the network lets nobody listen nothing is found.
    """

    def __init__(self) -> None:
        self._found: dict[str, FoundLeader] = {}
        self._asking: dict[str, asyncio.Task[None]] = {}
        self._hosts: list[str] = []
        self._listener: AsyncZeroconf | None = None
        self._browser: AsyncServiceBrowser | None = None

    @property
    def found(self) -> tuple[FoundLeader, ...]:
        """All that are announced at present, by name."""
        return tuple(sorted(self._found.values(), key=lambda leader: leader.name))

    async def __aenter__(self) -> Self:
        await self.refresh()
        return self

    async def __aexit__(self, *_: object) -> None:
        await self._stop()

    async def refresh(self) -> None:
        """Listen anew where this machine has other addresses now: a network may have come up since."""
        hosts = own_hosts(socket.AF_INET)
        if hosts == self._hosts:
            return
        await self._stop()
        self._hosts = hosts
        with contextlib.suppress(Error, OSError):
            self._listener = AsyncZeroconf(interfaces=hosts)
            self._browser = AsyncServiceBrowser(
                self._listener.zeroconf, SERVICE, handlers=[self._note_change]
            )

    async def _stop(self) -> None:
        asking = tuple(self._asking.values())
        for task in asking:
            task.cancel()
        await asyncio.gather(*asking, return_exceptions=True)
        self._found.clear()
        with contextlib.suppress(Error, OSError):
            if self._browser is not None:
                await self._browser.async_cancel()
            if self._listener is not None:
                await self._listener.async_close()
        self._browser = self._listener = None

    def _note_change(
        self, zeroconf: Zeroconf, service_type: str, name: str, state_change: ServiceStateChange
    ) -> None:
        if task := self._asking.pop(name, None):
            task.cancel()
        if state_change is ServiceStateChange.Removed:
            self._found.pop(name, None)
        elif len({*self._found, *self._asking, name}) <= MOST_LEADERS:
            self._asking[name] = asyncio.create_task(self._ask(zeroconf, name))

    async def _ask(self, zeroconf: Zeroconf, name: str) -> None:
        with contextlib.suppress(Error, OSError, ValueError):
            info = AsyncServiceInfo(SERVICE, name)
            if await info.async_request(zeroconf, DETAILS_MS):
                hosts = info.parsed_addresses(IPVersion.V4Only)[:MOST_ADDRESSES]
                port = info.port or 0
                told = info.decoded_properties
                self._found[name] = FoundLeader(
                    name=_short(name.removesuffix(f".{SERVICE}")),
                    addresses=tuple(Address(host, port) for host in hosts if 0 < port < 65536),
                    version=_short(told.get("version") or "?"),
                    is_relay=told.get("kind") == "relay",
                    pin=_short(told.get("pin") or ""),
                )
        self._asking.pop(name, None)


def _short(text: str) -> str:
    return " ".join(printable(text[:MOST_LETTERS]).split())
