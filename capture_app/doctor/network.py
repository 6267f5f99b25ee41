"""This machine's network: the leader, both ways to it, firewalls and WiFi."""

import asyncio
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from capture_app import __version__
from capture_app.doctor.finding import Finding
from capture_app.errors import SimulshotError
from capture_app.net.address import Address
from capture_app.net.discovery.announcement import announced_hosts
from capture_app.net.discovery.browser import FoundLeader, LeaderBrowser
from capture_app.net.firewall import MDNS_PORT, Firewall, active_firewalls
from capture_app.net.reach import find_obstacle
from capture_app.net.wifi import power_saving, power_saving_remedy, saves_power, wifi_interfaces
from capture_app.node.operator.requests import ask_status
from capture_app.text import count
from capture_app.trust.trust import Trust

LISTEN_S = 1.5


async def leader(address: Address) -> Finding:
    """Try the way to a leader."""
    began_s = time.monotonic()
    found = await find_obstacle(address)
    if found is not None:
        return Finding(check="leader", grade="problem", text=found.what, remedy=found.remedy)
    text = f"the leader at {address} answers within {(time.monotonic() - began_s) * 1e3:.0f} ms"
    return Finding(check="leader", grade="good", text=text)


async def own_rig(address: Address) -> Finding:
    """Say how other machines reach a rig of this machine."""
    try:
        status = await ask_status(address)
    except SimulshotError as error:
        return Finding(check="rig", grade="problem", text=error.what, remedy=error.hint)
    nodes = count(len(status.nodes), "node")
    if status.leader.startswith(("127.", "localhost", "[::1]")):
        return Finding(
            check="rig",
            grade="warning",
            text=f"a rig with {nodes} runs here, and only this machine reaches it, at {status.leader}",
            remedy="start it without --host 127.0.0.1 for cameras of other machines",
        )
    hosts = announced_hosts("") or [status.leader.rpartition(":")[0]]
    where = " or ".join(str(Address(host, address.port)) for host in hosts)
    return Finding(check="rig", grade="good", text=f"a rig with {nodes} runs here; others join it at {where}")


async def announced_leaders(listen_s: float = LISTEN_S) -> list[Finding]:
    """Say which leaders are announced in this network, whether they answer, and their version."""
    async with LeaderBrowser() as browser:
        await asyncio.sleep(listen_s)
        found = browser.found
    if not found:
        return [
            Finding(
                check="discovery",
                grade="note",
                text="no leader is announced in this network",
                remedy="start one with: capture-app; one that multicast does not reach is named by --leader",
            )
        ]
    return list(await asyncio.gather(*map(_announced_leader, found)))


async def _announced_leader(found: FoundLeader) -> Finding:
    kind = "relay" if found.is_relay else "leader"
    obstacles = await asyncio.gather(*map(find_obstacle, found.addresses))
    reached = [address for address, obstacle in zip(found.addresses, obstacles, strict=True) if not obstacle]
    if not reached:
        why = next((obstacle for obstacle in obstacles if obstacle is not None), None)
        text = f"{kind} {found.name} is announced and not reached: {why.what if why else 'it has no address'}"
        return Finding(check="discovery", grade="warning", text=text, remedy=why.remedy if why else "")
    text = f"{kind} {found.name} is announced and answers at {reached[0]}"
    if found.version != __version__:
        what = f"{text}; it runs simulshot {found.version}, this machine {__version__}"
        return Finding(check="discovery", grade="warning", text=what, remedy="install the same on both")
    return Finding(check="discovery", grade="good", text=text)


def warnings_for_leader(port: int, root: Path = Path("/")) -> list[str]:
    """Say what of this machine would keep other machines' cameras from a leader here, or make them worse.

    `root`: where its files are.
    """
    interfaces = wifi_interfaces(root / "sys/class/net")
    found = (*firewalls(active_firewalls(root), [port]), *wifi(interfaces))
    return [f"{finding.text}: {finding.remedy}" for finding in found if finding.grade == "warning"]


def firewalls(active: Sequence[Firewall], ports: Sequence[int]) -> Iterator[Finding]:
    """Say which firewalls of this machine may be in the way; to `ports` cameras come."""
    for firewall in active:
        for port in ports:
            opened = firewall.opens(port)
            if not opened:
                text = f"{firewall.name} is active here, and must let cameras come in to port {port}"
                unseen = " (only root sees whether it does)" if opened is None else ""
                remedy = firewall.opening.format(port=port)
                yield Finding(check="firewall", grade="warning", text=text + unseen, remedy=remedy)
        if not firewall.opens(MDNS_PORT) and firewall.name != "ufw":
            # As it comes, ufw lets mDNS in.
            text = f"{firewall.name} is active here: leaders are found by themselves only if it lets mDNS in"
            remedy = firewall.opening_udp.format(port=MDNS_PORT)
            yield Finding(check="firewall", grade="note", text=text, remedy=remedy)
    if not active:
        text = "no firewall is switched on here, by its files"
        yield Finding(check="firewall", grade="good", text=text)


def trust(own: Trust) -> Finding:
    """Say what this machine goes by, and how many it knows."""
    if own.is_open:
        return Finding(check="trust", grade="note", text="no machine is asked who it is")
    try:
        text = f"this machine's pin is {own.identity.pin}; it knows {count(len(own.known.all()), 'machine')}"
    except SimulshotError as error:
        return Finding(check="trust", grade="problem", text=error.what, remedy=error.hint)
    return Finding(check="trust", grade="good", text=text)


def wifi(interfaces: Sequence[str]) -> Iterator[Finding]:
    """Say which WiFi interfaces save power."""
    for interface in interfaces:
        match saves_power(interface):
            case True:
                yield Finding(
                    check="wifi",
                    grade="warning",
                    text=power_saving(interface),
                    remedy=power_saving_remedy(interface),
                )
            case False:
                text = f"the WiFi of this machine ({interface}) saves no power"
                yield Finding(check="wifi", grade="good", text=text)
            case None:
                text = f"the driver of {interface} does not say whether it saves power"
                yield Finding(check="wifi", grade="note", text=text)
