"""Addresses: `HOST:PORT` of a leader, with IPv6 hosts in brackets, and this machine's own addresses."""

import asyncio
import contextlib
import ipaddress
import re
import socket
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import ifaddr

from capture_app.common.errors import NetworkError

_IFF_UP, _IFF_LOOPBACK = 0x1, 0x8
_INTERFACES = Path("/sys/class/net")
_KNOWS_FLAGS = _INTERFACES.is_dir()
DEFAULT_PORT = 47010
ANY_HOST = ("", "0.0.0.0", "::")  # noqa: S104 - cameras are other machines
"""Hosts that mean all interfaces."""
LOOPBACK_HOSTS = ("localhost", "127.0.0.1", "::1")
"""Hosts that only this machine can connect to."""

_BRACKETED = re.compile(r"\[(?P<host>[^\[\]]+)\](?::(?P<port>\d+))?")
_PLAIN = re.compile(r"(?P<host>[^:\[\]\s]+)(?::(?P<port>\d+))?")


def own_hosts(family: socket.AddressFamily) -> list[str]:
    """Return the addresses of the interfaces that are up, without loopback; empty if unknown."""
    return [str(host) for _, host in _named_hosts() if (host.version == 4) == (family == socket.AF_INET)]


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
            # Only Linux has these files; others name no interface that is down.
            flags = int((_INTERFACES / adapter.name / "flags").read_text(), 16) if _KNOWS_FLAGS else _IFF_UP
            if flags & _IFF_UP and not flags & _IFF_LOOPBACK:
                for ip in adapter.ips:
                    host = ipaddress.ip_address(ip.ip if isinstance(ip.ip, str) else ip.ip[0])
                    # A link-local IPv6 address is not usable without its interface.
                    if not host.is_loopback and (host.version == 4 or not host.is_link_local):
                        yield adapter.name, host


class Address(NamedTuple):
    """Host, as a name or a numeric address, and a port that serves both UDP and TCP."""

    host: str
    port: int

    def __str__(self) -> str:
        return f"[{self.host}]:{self.port}" if ":" in self.host else f"{self.host}:{self.port}"


def parse_address(text: str) -> Address:
    """Parse `HOST`, `HOST:PORT`, `[IPV6]` or `[IPV6]:PORT`; raises ValueError with the reason."""
    if (match := _BRACKETED.fullmatch(text) or _PLAIN.fullmatch(text)) is None:
        hint = f", or did you mean [{text}]?" if text.count(":") > 1 and "[" not in text else ""
        raise ValueError(f"{text!r} is not HOST:PORT{hint}")
    port = int(match["port"]) if match["port"] else DEFAULT_PORT
    if not 0 < port < 65536:
        raise ValueError(f"port {port} in {text!r} is not between 1 and 65535")
    try:
        match["host"].encode("idna")
    except UnicodeError:
        raise ValueError(f"the host in {text!r} has an empty part or one of over 63 letters") from None
    return Address(match["host"], port)


async def resolve(address: Address) -> tuple[socket.AddressFamily, Address]:
    """Return the address family and the numeric address of a host; raises NetworkError if it has none."""
    try:
        hosts = await asyncio.get_running_loop().getaddrinfo(
            address.host, address.port, type=socket.SOCK_DGRAM, proto=socket.IPPROTO_UDP
        )
    except (OSError, UnicodeError) as error:
        raise NetworkError(
            f"cannot resolve host {address.host!r}: {getattr(error, 'strerror', None) or error}",
            hint="check the name, or give its IP address",
        ) from error
    # Most leaders listen on IPv4 only, so it is preferred if a name has both.
    family, _, _, _, where = min(hosts, key=lambda entry: entry[0] != socket.AF_INET)
    return family, Address(str(where[0]), int(where[1]))


def reachable_host(
    host: str,
    family: socket.AddressFamily,
    *,
    find_source: Callable[[str, socket.AddressFamily], str | None] = source_address,
    find_own: Callable[[socket.AddressFamily], list[str]] = own_hosts,
) -> str:
    """Return the host to announce to nodes; for `any`, this machine's address on the default route.

    Without such a route, as in an isolated network, it is the address of the first interface.
    """
    if host not in ANY_HOST:
        return host
    outside, loopback = (
        ("10.255.255.255", "127.0.0.1") if family == socket.AF_INET else ("2001:db8::1", "::1")
    )
    return find_source(outside, family) or next(iter(find_own(family)), loopback)


def listen_tcp(host: str, *ports: int) -> socket.socket:
    """Return a socket that listens on the first free one of `ports`; port 0 selects any free port.

    Raises NetworkError, about the last port, if none is free.
    """
    *first, last = ports
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    for port in first:
        with contextlib.suppress(OSError):
            return socket.create_server((host, port), family=family)
    try:
        return socket.create_server((host, last), family=family)
    except (OSError, UnicodeError) as error:
        raise NetworkError(
            f"cannot listen on {Address(host, last)}: {getattr(error, 'strerror', None) or error}",
            hint="choose another with --host and --port; --port 0 takes a free one",
        ) from error


def own_machine_address(host: str, family: socket.AddressFamily, port: int) -> Address:
    """Return the address for this machine's processes to a port of `host`; loopback for `any`."""
    loopback = "127.0.0.1" if family == socket.AF_INET else "::1"
    return Address(loopback if host in ANY_HOST else host, port)
