"""Announcing, finding and choosing leaders on a network that is only drawn, in virtual time."""

import asyncio
import socket
from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import Any

import pytest
from zeroconf import ServiceStateChange

from capture_app import __version__
from capture_app.common import system
from capture_app.common.address import Address
from capture_app.common.pairing_codes import Role
from capture_app.net import discovery
from capture_app.net.discovery import (
    LOOK_EVERY_S,
    MAX_LEADERS,
    MAX_TXT_BYTES,
    NOBODY,
    OTHERS_S,
    SAY_S,
    SERVICE,
    LeaderBrowser,
    announced,
    search_leaders,
)  # fmt: skip
from capture_app.protocol.pairing_messages import FoundLeader
from capture_app.trust.trust import Peer

pytestmark = pytest.mark.virtual
HERE = Address("127.0.0.1", 1)


class Network:
    """What is announced, who listens, and which addresses answer."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:  # noqa: C901 - three stand-ins of zeroconf
        self.services: dict[str, Any] = {}
        self.listening: list[Any] = []
        self.open: list[Any] = []
        self.hosts, self.is_down, self.alive = ["10.0.0.1"], False, set[Address]()
        network = self

        class Zeroconf:
            def __init__(self, interfaces: Sequence[str]) -> None:
                if network.is_down:
                    raise OSError("no network")
                self.zeroconf, self.interfaces, self.own = self, interfaces, list[str]()
                network.open.append(self)

            async def async_register_service(self, info: Any, *, allow_name_change: bool) -> Any:
                assert allow_name_change
                self.own.append(info.name)
                network.services[info.name] = info
                network.tell(info.name, ServiceStateChange.Added)
                return asyncio.sleep(0)

            async def async_close(self) -> None:
                network.open.remove(self)
                for name in self.own:
                    network.remove(name)

        class Browser:
            def __init__(self, zeroconf: Any, service: str, handlers: list[Any]) -> None:
                assert service == SERVICE
                self.handlers = handlers
                network.listening.append(self)
                for name in network.services:
                    handlers[0](zeroconf, service, name, ServiceStateChange.Added)

            async def async_cancel(self) -> None:
                network.listening.remove(self)

        class Info:
            def __init__(self, service: str, name: str, **details: Any) -> None:
                self.name, self.details, self.addresses = name, details, list[bytes]()
                self.port: int | None = details.get("port")

            async def async_request(self, _: Any, __: int) -> bool:
                await asyncio.sleep(0.1)
                if (announced := network.services.get(self.name)) is None:
                    return False
                self.details, self.addresses, self.port = (
                    announced.details,
                    announced.addresses,
                    announced.port,
                )
                return True

            def parsed_addresses(self, _: Any) -> list[str]:
                return [socket.inet_ntoa(address) for address in self.addresses]

            @property
            def decoded_properties(self) -> dict[str, str]:
                properties: dict[str, str] = self.details["properties"]
                return properties

        for name, value in {
            "AsyncZeroconf": Zeroconf, "AsyncServiceBrowser": Browser, "AsyncServiceInfo": Info,
            "own_hosts": lambda _: self.hosts, "first_to_answer": self.first_to_answer,
            "find_obstacle": self.find_obstacle,
        }.items():  # fmt: skip
            monkeypatch.setattr(discovery, name, value)
        monkeypatch.setattr(system, "monotonic_s", lambda: asyncio.get_running_loop().time())

    def tell(self, name: str, change: ServiceStateChange) -> None:
        for browser in self.listening:
            browser.handlers[0](None, SERVICE, name, change)

    def remove(self, name: str) -> None:
        del self.services[name]
        self.tell(name, ServiceStateChange.Removed)

    async def first_to_answer(self, leaders: Sequence[Address], silence_s: float) -> Address | None:
        for leader in leaders:
            if leader in self.alive:
                return leader
        await asyncio.sleep(silence_s)
        return None

    async def find_obstacle(self, address: Address) -> str | None:
        return None if address in self.alive else f"{address} is shut"


@pytest.fixture
def network(monkeypatch: pytest.MonkeyPatch) -> Network:
    return Network(monkeypatch)


def machine(*known: str) -> Any:
    """A trust that knows leaders by these pins; without any an open one."""
    return SimpleNamespace(
        is_open=not known,
        identity=SimpleNamespace(pin="own"),
        peer_of=lambda pin: Peer(pin, roles=frozenset({Role.LEADER} if pin in known else ())),
    )


async def test_an_announcement_is_found_with_what_it_says_until_it_ends(network: Network) -> None:
    among = (Address("10.0.0.1", 5), Address("10.0.0.2", 5))
    async with LeaderBrowser() as browser:
        await browser.refresh()
        async with announced("0.0.0.0", 5, "relay", name="x" * 99, trust=machine("a"), among=among):
            await asyncio.sleep(1)
            assert browser.found == (
                FoundLeader(
                    f"{'x' * 50}-5", (among[0],), __version__, is_relay=True, key="own", among=among
                ),
            )  # fmt: skip
            many = [Address(f"10.0.0.{number}", 47010) for number in range(40)]
            assert len(",".join(map(str, many))) > MAX_TXT_BYTES
            async with announced("0.0.0.0", 6, "leader", trust=machine(), among=many, instance=9):
                await asyncio.sleep(1)
                relay, leader = sorted(browser.found, key=lambda of: not of.is_relay)
                assert (leader.key, leader.among, leader.is_relay, relay.is_relay) == ("9", (), False, True)
        assert browser.found == ()
    assert not network.listening


async def test_a_machine_announces_and_listens_anew_when_its_network_changes(network: Network) -> None:
    async with LeaderBrowser() as browser, announced("0.0.0.0", 5, "leader", trust=machine()):
        for hosts in (["10.0.0.1"], [], ["10.0.0.7", "192.168.0.1"]):
            network.hosts = hosts
            await asyncio.sleep(LOOK_EVERY_S + 0.1)
            await browser.refresh()
            first = network.listening[:1]
            await asyncio.sleep(0.2)
            await browser.refresh()
            assert network.listening == first
            found = [address.host for leader in browser.found for address in leader.addresses]
            assert found == hosts
        network.is_down, network.hosts = True, ["10.0.0.3"]
        await browser.refresh()
        assert browser.found == (), "of another network"
        await asyncio.sleep(LOOK_EVERY_S + 0.1)
        assert not network.services
        network.is_down, network.hosts = False, hosts
        await asyncio.sleep(LOOK_EVERY_S)
        assert len(network.services) == 1, "it is tried again"
    assert not network.open


async def test_what_is_announced_may_be_anything(network: Network) -> None:
    def announce(name: str, port: int | None, **properties: str | None) -> None:
        network.services[f"{name}.{SERVICE}"] = SimpleNamespace(
            details={"properties": properties}, addresses=[bytes((10, 0, 0, 1))] * 20, port=port
        )

    announce("a\x1b[2J  b" + "x" * 99, 5)
    announce("none", None)
    announce("large", 65_536)
    announce("last", 65_535, leaders="10.0.0.1:none")
    for number in range(MAX_LEADERS + 5):
        announce(f"z{number}", 65_535)
    async with LeaderBrowser() as browser:
        await browser.refresh()
        await asyncio.sleep(1)
        found = {leader.name: leader for leader in browser.found}
    assert len(found) == MAX_LEADERS - 1
    assert "last" not in found, "its list of leaders is none"
    first = next(leader for name, leader in found.items() if name.startswith("a"))
    assert first.name == "a\\x1b[2J b" + "x" * (discovery.MAX_NAME_LETTERS - 8)
    assert (first.version, first.key, len(first.addresses)) == ("?", "", discovery.MAX_ADDRESSES)
    assert found["none"].addresses == found["large"].addresses == ()
    assert found["z0"].addresses[0].port == 65_535


class Search:
    """A search among leaders that come at their times."""

    def __init__(self, network: Network, monkeypatch: pytest.MonkeyPatch) -> None:
        self.network, self.said, self.here = network, list[tuple[float, str]](), list[Address]()
        self.leaders: list[tuple[float, FoundLeader]] = []
        search = self

        class Browser(LeaderBrowser):
            is_listening = False

            async def refresh(self) -> None:
                self.is_listening = True

            @property
            def found(self) -> tuple[FoundLeader, ...]:
                assert self.is_listening
                return tuple(of for at_s, of in search.leaders if search.now_s() >= at_s)

        monkeypatch.setattr(discovery, "LeaderBrowser", Browser)
        self.began_s = asyncio.get_running_loop().time()
        network.alive.clear()

    def now_s(self) -> float:
        return asyncio.get_running_loop().time() - self.began_s

    def add(self, name: str, at_s: float = 0.0, *, answers: bool = True, relay: bool = False) -> Address:
        """A leader, whose pin is its name, is announced at that time."""
        address = Address(f"10.0.0.{len(self.leaders) + 1}", 5)
        among = (address, HERE)
        self.leaders.append((at_s, FoundLeader(name, (address,), is_relay=relay, key=name, among=among)))
        if answers:
            self.network.alive.add(address)
        return address

    async def run(self, trust: Any, **followed: Sequence[Address]) -> tuple[list[str], float]:
        """Return the names of the leaders that are found, and when."""
        found = await search_leaders(
            lambda: self.here, lambda text: self.said.append((self.now_s(), text)), trust=trust,
            followed=followed,
        )  # fmt: skip
        self.found = found
        return [leader.name for leader in found], self.now_s()


@pytest.fixture
def searching(network: Network, monkeypatch: pytest.MonkeyPatch) -> Callable[[], Search]:
    return lambda: Search(network, monkeypatch)


def soon(found: tuple[list[str], float], *names: str, after_s: float = OTHERS_S, by_s: float = 1.0) -> bool:
    return found[0] == [*names] and after_s <= found[1] <= after_s + by_s


async def test_a_known_leader_is_taken_at_once_and_others_only_where_none_comes(
    searching: Callable[[], Search],
) -> None:
    search = searching()
    search.add("relay", relay=True)
    search.add("stranger")
    search.add("known")
    assert soon(await search.run(machine("known", "relay")), "known")
    search = searching()
    search.add("relay", relay=True)
    search.add("known", at_s=1.0)
    assert soon(await search.run(machine("known", "relay")), "known", after_s=1.0), "a relay answers sooner"
    search = searching()
    search.add("relay", relay=True)
    assert soon(await search.run(machine("relay")), "relay", after_s=SAY_S)
    search = searching()
    search.add("stranger")
    search.add("silent", answers=False)
    assert soon(await search.run(machine("known")), "stranger", after_s=SAY_S, by_s=2.0)
    assert not search.found[0].is_known
    search = searching()
    search.add("one")
    search.add("two")
    assert soon(await search.run(machine()), "one", "two"), "in an open rig all are known"
    assert search.found[0].among == (), "and none says who else is"


async def test_this_machines_leader_is_taken_before_all_others(searching: Callable[[], Search]) -> None:
    search = searching()
    search.add("known")
    search.here = [HERE]
    search.network.alive.add(HERE)
    assert soon(await search.run(machine("known")), "this machine", after_s=0.0, by_s=0.1)


async def test_what_hinders_is_said_once_whenever_it_changes(searching: Callable[[], Search]) -> None:
    search = searching()
    shut = search.add("shut", at_s=5.0, answers=False)
    search.add("known", at_s=9.0)
    assert soon(await search.run(machine("known")), "known", after_s=9.0, by_s=2.5)
    assert [text for _, text in search.said] == [NOBODY, f"{shut} is shut"]
    assert SAY_S <= search.said[0][0] <= SAY_S + 1.5


async def test_the_leader_that_was_followed_last_is_waited_for(searching: Callable[[], Search]) -> None:
    search = searching()
    search.add("other")
    search.add("first", at_s=1.5)
    search.add("last", at_s=1.5)
    known = machine("other", "first", "last")
    assert soon(await search.run(known, first=(), last=()), "last", after_s=1.5)
    search = searching()
    search.add("other")
    assert soon(await search.run(known, first=(), last=()), "other", after_s=SAY_S)
    search = searching()
    search.add("last")
    search.add("known")
    assert soon(await search.run(machine("known"), last=()), "known", after_s=SAY_S), "no longer known"


async def test_an_open_rigs_leader_that_was_started_again_is_at_its_address(
    searching: Callable[[], Search],
) -> None:
    search = searching()
    search.add("other")
    address = search.add("new instance")
    found = await search.run(machine(), old=(address,))
    assert soon(found, "new instance")
    assert search.found[0].key == "old"
    search = searching()
    search.add("other")
    address = search.add("new")
    assert soon(await search.run(machine("other", "new"), old=(address,)), "other", "new", after_s=SAY_S)
