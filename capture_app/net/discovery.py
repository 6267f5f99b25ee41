"""Leaders and relays on the local network by mDNS: announced, browsed, and searched for one that answers.

A search tries the leader of this machine first, then those that are announced.
"""

import asyncio
import contextlib
import secrets
import socket
import time
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager
from typing import Literal, Self

from msgspec.structs import replace
from zeroconf import Error, IPVersion, ServiceStateChange, Zeroconf
from zeroconf.asyncio import AsyncServiceBrowser, AsyncServiceInfo, AsyncZeroconf

from capture_app import __version__
from capture_app.common.address import ANY_HOST, Address, parse_address
from capture_app.common.interfaces import own_hosts
from capture_app.common.names import name_like
from capture_app.common.pairing_codes import Role
from capture_app.common.tasks import end
from capture_app.common.text import printable
from capture_app.net.reach import find_obstacle, first_to_answer
from capture_app.protocol.pairing import FoundLeader
from capture_app.sync.wire.codec import VERSION
from capture_app.trust.trust import Trust

SERVICE = "_simulshot._udp.local."
LOOK_EVERY_S = 5.0
"""Between two looks at which addresses this machine has: a network may come up later, or change."""
GOODBYE_S = 1.0
MOST_LABEL_LETTERS = 50
"""How long a name may be: with the port it must be a label of DNS, of 63 bytes."""

Kind = Literal["leader", "relay"]
MOST_LEADERS, MOST_ADDRESSES, MOST_NAME_LETTERS = 32, 16, 80
MOST_TOLD = 240
"""Letters of all leaders' addresses that are announced: a property of DNS has 255 with its name."""
DETAILS_MS = 3000
"""How long to ask for the address of one that was heard of."""
OWN_S = 0.5
"""How long this machine's own leaders may take to answer."""
OTHERS_S = 0.6
"""How long to listen for further leaders: all of one network have answered by then."""
ANSWER_S = 1.0
SAY_S = 2.0
ASK_EVERY_S = 0.2
NOBODY = (
    "no leader is found in this network yet: start one with: capture-app (on the machine that is to save the"
    " pictures), or give its address: --leader HOST:PORT"
)


@asynccontextmanager
async def announced(
    host: str,
    port: int,
    kind: Kind,
    *,
    name: str | None = None,
    trust: Trust | None = None,
    among: Sequence[Address] = (),
) -> AsyncIterator[None]:
    """Announce what listens on `host` and `port` while the block runs, by `name`, else that of this machine.

    Its pin is that of `trust`, else of its user's; nodes that know it prefer it. `among` are all leaders of
    its rig, the best first. One that only this machine can reach, or by IPv6 only, is not announced; a
    network that does not let it be announced only costs that.
    """
    own = trust or Trust.of_user()
    info = _service_info(port, kind, name, "" if own.is_open else own.identity.pin, among)
    task = asyncio.create_task(_keep_announced(host, info))
    try:
        yield
    finally:
        await end(task)


def announced_hosts(host: str) -> list[str]:
    """Return the IPv4 addresses at which other machines reach what listens on `host`."""
    if host in ANY_HOST:
        return sorted(own_hosts(socket.AF_INET))
    with contextlib.suppress(OSError):
        found = socket.getaddrinfo(host, None, socket.AF_INET, socket.SOCK_DGRAM)
        return sorted({str(where[0]) for *_, where in found if not str(where[0]).startswith("127.")})
    return []


def _service_info(
    port: int, kind: Kind, name: str | None, pin: str, among: Sequence[Address]
) -> AsyncServiceInfo:
    name = name or name_like(socket.gethostname().split(".")[0], "simulshot")
    label, leaders = f"{name[:MOST_LABEL_LETTERS]}-{port}", ",".join(map(str, among))
    return AsyncServiceInfo(
        SERVICE,
        f"{label}.{SERVICE}",
        port=port,
        properties={
            "version": __version__,
            "protocol": str(VERSION),
            "kind": kind,
            "pin": pin,
            "leaders": leaders if len(leaders) <= MOST_TOLD else "",
        },
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
        await end(*self._asking.values())
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
                    among=tuple(map(parse_address, filter(None, (told.get("leaders") or "").split(",")))),
                )
        self._asking.pop(name, None)


def _short(text: str) -> str:
    return " ".join(printable(text[:MOST_NAME_LETTERS]).split())


async def search_leaders(
    own: Callable[[], Sequence[Address]], tell: Callable[[str], None], *, trust: Trust | None = None
) -> list[FoundLeader]:
    """Wait until there is a leader that answers, and return all of them; relays only where there is none.

    Where `trust`, else that of this user, knows some of them, these are all. `own` are the addresses at which
    this machine may have one: the first that answers is the only one returned. `tell` gets a sentence about
    what is in the way, when there is a new one.
    """
    began_s, said = time.monotonic(), ""
    async with LeaderBrowser() as browser:
        while True:
            asked_s = time.monotonic()
            await browser.refresh()
            mine = await first_to_answer(own(), OWN_S)
            if mine is not None:
                return [FoundLeader("this machine", (mine,))]
            await asyncio.sleep(max(0.0, began_s + OTHERS_S - time.monotonic()))
            found = browser.found
            answered = await _answering(found, trust or Trust.of_user())
            is_late = time.monotonic() - began_s >= SAY_S
            # A relay, or a stranger's leader, may only have been quicker.
            if any(one.is_known and not one.is_relay for one in answered) or (answered and is_late):
                return _best(answered)
            if is_late:
                sentence = await _what_is_in_the_way(found)
                if sentence != said:
                    tell(sentence)
                    said = sentence
            await asyncio.sleep(max(0.0, asked_s + ASK_EVERY_S - time.monotonic()))


async def _answering(found: Sequence[FoundLeader], trust: Trust) -> list[FoundLeader]:
    """Return those that answer, each at the address that answers first."""
    addresses = await asyncio.gather(*(first_to_answer(leader.addresses, ANSWER_S) for leader in found))
    return [
        replace(
            leader,
            addresses=(address,),
            is_known=_knows(trust, leader.pin),
            # Anybody can announce other leaders: they are followed only where each has to prove its key.
            among=() if trust.is_open else leader.among,
        )
        for leader, address in zip(found, addresses, strict=True)
        if address is not None
    ]


def _best(answered: Sequence[FoundLeader]) -> list[FoundLeader]:
    """Return those that are known, where some are, and of these the leaders, where some are."""
    known = [one for one in answered if one.is_known] or list(answered)
    return [one for one in known if not one.is_relay] or known


def _knows(trust: Trust, pin: str) -> bool:
    if trust.is_open:
        return True
    machine = trust.known.find(pin)
    return pin == trust.identity.pin or (machine is not None and Role.LEADER in machine.roles)


async def _what_is_in_the_way(found: Sequence[FoundLeader]) -> str:
    obstacles = await asyncio.gather(
        *(find_obstacle(address) for leader in found for address in leader.addresses[:1])
    )
    return "; ".join(str(obstacle) for obstacle in obstacles if obstacle is not None) or NOBODY
