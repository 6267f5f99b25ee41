"""mDNS discovery of leaders and relays: announcing, browsing, and searching for one that answers.

A search tries the leader of this machine first, then the announced ones.
"""

import asyncio
import contextlib
import secrets
import socket
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from contextlib import AbstractAsyncContextManager, AsyncExitStack, asynccontextmanager
from typing import Literal

from msgspec.structs import replace
from zeroconf import Error, IPVersion, ServiceStateChange, Zeroconf
from zeroconf.asyncio import AsyncServiceBrowser, AsyncServiceInfo, AsyncZeroconf

from capture_app import __version__
from capture_app.common import system
from capture_app.common.address import ANY_HOST, Address, own_hosts, parse_address
from capture_app.common.names import name_like
from capture_app.common.pairing_codes import Role
from capture_app.common.tasks import end
from capture_app.common.text import printable
from capture_app.net.reachability import find_obstacle, first_to_answer
from capture_app.protocol.pairing_messages import FoundLeader
from capture_app.sync.wire.codec import VERSION
from capture_app.trust.trust import Trust

SERVICE = "_simulshot._udp.local."
LOOK_EVERY_S = 2.0
"""Interval between checks of this machine's addresses: a network may come up later, or change."""
GOODBYE_S = 1.0
MAX_LABEL_LETTERS = 50
"""Maximum length of a name; with the port it must fit into a DNS label of 63 bytes."""

Kind = Literal["leader", "relay"]
MAX_LEADERS, MAX_ADDRESSES, MAX_NAME_LETTERS = 32, 16, 80
MAX_TXT_BYTES = 240
"""Maximum length of the list of leader addresses; a DNS property holds 255 bytes including its name."""
DETAILS_MS = 3000
"""Timeout for resolving an announced service."""
OWN_S = 0.5
"""Timeout for this machine's own leaders."""
OTHERS_S = 0.6
"""Listening time for further leaders; all of one network have answered by then."""
ANSWER_S = 1.0
SAY_S = 2.0
ASK_EVERY_S = 0.2
NOBODY = (
    "no leader found on this network yet: start one with: capture-app (on the machine that is to save the"
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
    instance: int = 0,
) -> AsyncIterator[None]:
    """Announce a leader or relay on `host` and `port` while the block runs, as `name`, else as this machine.

    Its pin comes from `trust`, by default its user's; nodes that know the pin prefer it. In an open rig, they
    prefer the `instance` that they followed. `among` are all leaders of its rig, best first. A leader
    reachable only from this machine or only by IPv6 is not announced. A network that prevents announcements
    causes no error.
    """
    own = trust or Trust.of_user()
    name = name or name_like(socket.gethostname().split(".")[0], "simulshot")
    leaders = ",".join(map(str, among))
    info = AsyncServiceInfo(
        SERVICE,
        f"{name[:MAX_LABEL_LETTERS]}-{port}.{SERVICE}",
        port=port,
        properties={
            "version": __version__,
            "protocol": str(VERSION),
            "kind": kind,
            "pin": str(instance) if own.is_open else own.identity.pin,
            "leaders": leaders if len(leaders) <= MAX_TXT_BYTES else "",
        },
        # A host name of its own, because the machine's mDNS daemon owns the machine's name.
        server=f"simulshot-{secrets.token_hex(4)}.local.",
    )
    task = asyncio.create_task(_keep_announced(host, info))
    try:
        yield
    finally:
        await end(task)


def announced_hosts(host: str) -> list[str]:
    """Return the IPv4 addresses at which other machines reach a server on `host`."""
    if host in ANY_HOST:
        return sorted(own_hosts(socket.AF_INET))
    with contextlib.suppress(OSError):
        return sorted(
            {
                str(where[0])
                for *_, where in socket.getaddrinfo(host, None, socket.AF_INET, socket.SOCK_DGRAM)
                if not str(where[0]).startswith("127.")
            }
        )
    return []


async def _keep_announced(host: str, info: AsyncServiceInfo) -> None:
    hosts: list[str] | None = None
    async with AsyncExitStack() as announcing:
        while True:
            if (hosts_now := announced_hosts(host)) != hosts:
                await announcing.aclose()
                # A failed announcement is ended and retried at the next look, whatever the addresses then.
                hosts = None
                with contextlib.suppress(Error, OSError, TimeoutError):
                    if hosts_now:
                        responder = AsyncZeroconf(interfaces=hosts_now)
                        announcing.push_async_callback(_close, responder)
                        info.addresses = [socket.inet_aton(leader) for leader in hosts_now]
                        await (await responder.async_register_service(info, allow_name_change=True))
                    hosts = hosts_now
            await asyncio.sleep(LOOK_EVERY_S)


async def _close(responder: AsyncZeroconf) -> None:
    with contextlib.suppress(Error, OSError, TimeoutError):
        async with asyncio.timeout(GOODBYE_S):
            await responder.async_close()


class LeaderBrowser(AbstractAsyncContextManager["LeaderBrowser"]):
    """Listener for announcements, from `refresh` on until the end of `async with LeaderBrowser()`.

    On a network that does not allow listening it finds nothing.
    """

    def __init__(self) -> None:
        self._found: dict[str, FoundLeader] = {}
        self._asking: dict[str, asyncio.Task[None]] = {}
        self._hosts: list[str] = []
        self._listening = AsyncExitStack()

    @property
    def found(self) -> tuple[FoundLeader, ...]:
        """All currently announced leaders and relays, by name."""
        return tuple(sorted(self._found.values(), key=lambda leader: leader.name))

    async def __aexit__(self, *_: object) -> None:
        await self._stop()

    async def refresh(self) -> None:
        """Listen, from now on or again if its addresses have changed, as when a network came up."""
        hosts = own_hosts(socket.AF_INET)
        if hosts == self._hosts:
            return
        await self._stop()
        self._hosts = hosts
        with contextlib.suppress(Error, OSError):
            listener = AsyncZeroconf(interfaces=hosts)
            self._listening.push_async_callback(listener.async_close)
            browser = AsyncServiceBrowser(listener.zeroconf, SERVICE, handlers=[self._note_change])
            self._listening.push_async_callback(browser.async_cancel)

    async def _stop(self) -> None:
        await end(*self._asking.values())
        self._found.clear()
        with contextlib.suppress(Error, OSError):
            await self._listening.aclose()

    def _note_change(
        self, zeroconf: Zeroconf, service_type: str, name: str, state_change: ServiceStateChange
    ) -> None:
        if task := self._asking.pop(name, None):
            task.cancel()
        if state_change is ServiceStateChange.Removed:
            self._found.pop(name, None)
        elif len({*self._found, *self._asking, name}) <= MAX_LEADERS:
            self._asking[name] = asyncio.create_task(self._ask(zeroconf, name))

    async def _ask(self, zeroconf: Zeroconf, name: str) -> None:
        with contextlib.suppress(Error, OSError, ValueError):
            info = AsyncServiceInfo(SERVICE, name)
            if await info.async_request(zeroconf, DETAILS_MS):
                hosts, port = info.parsed_addresses(IPVersion.V4Only)[:MAX_ADDRESSES], info.port or 0
                properties = info.decoded_properties
                self._found[name] = FoundLeader(
                    name=_short(name.removesuffix(f".{SERVICE}")),
                    addresses=tuple(Address(host, port) for host in hosts if 0 < port < 65536),
                    version=_short(properties.get("version") or "?"),
                    is_relay=properties.get("kind") == "relay",
                    key=_short(properties.get("pin") or ""),
                    among=tuple(
                        map(parse_address, filter(None, (properties.get("leaders") or "").split(",")))
                    ),
                )
        self._asking.pop(name, None)


def _short(text: str) -> str:
    return " ".join(printable(text[:MAX_NAME_LETTERS]).split())


async def search_leaders(
    own: Callable[[], Sequence[Address]],
    report: Callable[[str], None],
    *,
    trust: Trust | None = None,
    followed: Mapping[str, Sequence[Address]] = {},
) -> list[FoundLeader]:
    """Wait until a leader answers, and return all that answer; relays only if no leader does.

    A leader on this machine, at one of the addresses `own`, is returned alone. So is, of the others, the one
    that was followed last: `followed` has the addresses of each, by its key. Otherwise, if `trust` (default:
    this user's) knows some of them, only these are returned. `report` gets a sentence about what
    prevents a connection, whenever that changes.
    """
    began_s, said, trust = system.monotonic_s(), "", trust or Trust.of_user()
    async with LeaderBrowser() as browser:
        while True:
            asked_s = system.monotonic_s()
            await browser.refresh()
            if (mine := await first_to_answer(own(), OWN_S)) is not None:
                return [FoundLeader("this machine", (mine,))]
            await asyncio.sleep(max(0.0, began_s + OTHERS_S - system.monotonic_s()))
            leaders = browser.found
            answered = await _answering(leaders, trust)
            is_late = system.monotonic_s() - began_s >= SAY_S
            for key, addresses in reversed([*followed.items()]):
                same = [leader for leader in answered if leader.is_known and leader.key == key]
                # Of an open rig's leader that was started again, only the address is the same.
                if same := same or [
                    leader for leader in answered if trust.is_open and leader.addresses[0] in addresses
                ]:
                    return [replace(same[0], key=key)]
            # A relay, or another leader, may merely have answered sooner.
            is_best = not followed and any(leader.is_known and not leader.is_relay for leader in answered)
            if is_best or (answered and is_late):
                known = [leader for leader in answered if leader.is_known] or answered
                return [leader for leader in known if not leader.is_relay] or known
            if is_late:
                obstacles = await asyncio.gather(
                    *(find_obstacle(address) for leader in leaders for address in leader.addresses[:1])
                )
                sentence = (
                    "; ".join(str(obstacle) for obstacle in obstacles if obstacle is not None) or NOBODY
                )
                if sentence != said:
                    report(sentence)
                    said = sentence
            await asyncio.sleep(max(0.0, asked_s + ASK_EVERY_S - system.monotonic_s()))


async def _answering(leaders: Sequence[FoundLeader], trust: Trust) -> list[FoundLeader]:
    """Return the leaders that answer, each with the address that answers first."""
    addresses = await asyncio.gather(*(first_to_answer(leader.addresses, ANSWER_S) for leader in leaders))
    return [
        replace(
            leader,
            addresses=(address,),
            is_known=trust.is_open or trust.peer_of(leader.key).may(Role.LEADER),
            # Anyone can announce other leaders. They are followed only where each has to prove its key.
            among=() if trust.is_open else leader.among,
        )
        for leader, address in zip(leaders, addresses, strict=True)
        if address is not None
    ]
