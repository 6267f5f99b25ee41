"""Addresses of this machine's own network interfaces, as reported by Linux."""

import contextlib
import ipaddress
import socket
from collections.abc import Iterator
from pathlib import Path

import ifaddr

_IFF_UP, _IFF_LOOPBACK = 0x1, 0x8
_NETWORKS = Path("/sys/class/net")


def own_hosts(family: socket.AddressFamily) -> list[str]:
    """Return the addresses of the interfaces that are up, without loopback; empty if unknown."""
    version = 4 if family == socket.AF_INET else 6
    return [str(host) for _, host in _named_hosts() if host.version == version]


def interface_of(address: str) -> str | None:
    """Return the name of the interface with an address; None if there is none, or it is unknown."""
    return next((name for name, host in _named_hosts() if str(host) == address), None)


def source_address(host: str, family: socket.AddressFamily = socket.AF_INET) -> str | None:
    """Return this machine's source address for the route to a host; None without a route."""
    with contextlib.suppress(OSError), socket.socket(family, socket.SOCK_DGRAM) as probe:
        # Connecting a datagram socket sends nothing; it only selects the route.
        probe.connect((host, 9))
        return str(probe.getsockname()[0])
    return None


def _named_hosts() -> Iterator[tuple[str, ipaddress.IPv4Address | ipaddress.IPv6Address]]:
    for adapter in ifaddr.get_adapters():
        with contextlib.suppress(OSError):
            flags = int((_NETWORKS / adapter.name / "flags").read_text(), 16)
            if flags & _IFF_UP and not flags & _IFF_LOOPBACK:
                found = (ip.ip if isinstance(ip.ip, str) else ip.ip[0] for ip in adapter.ips)
                hosts = map(ipaddress.ip_address, found)
                # A link-local IPv6 address is not usable without its interface.
                yield from ((adapter.name, one) for one in hosts if one.version == 4 or not one.is_link_local)
