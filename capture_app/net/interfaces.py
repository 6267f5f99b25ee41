"""The addresses of this machine's own network interfaces, as Linux tells them."""

import contextlib
import fcntl
import ipaddress
import socket
import struct
from pathlib import Path

_SIOCGIFFLAGS = 0x8913
_SIOCGIFADDR = 0x8915
_IFF_UP = 0x1
_IFF_LOOPBACK = 0x8
_REQUEST_BYTES = 40
_GLOBAL_SCOPE = "00"
_IF_INET6 = Path("/proc/net/if_inet6")


def own_hosts(family: socket.AddressFamily) -> list[str]:
    """Return the addresses of the interfaces that are up, without loopback; empty if not known."""
    return _hosts_v4() if family == socket.AF_INET else _hosts_v6()


def interface_of(address: str) -> str | None:
    """Return the name of the interface that has an IPv4 address; None where none has, or it is not known."""
    return next((name for name, host in _named_hosts_v4() if host == address), None)


def source_address(host: str, family: socket.AddressFamily = socket.AF_INET) -> str | None:
    """Return this machine's address on the way to a host; None where there is no such way."""
    with contextlib.suppress(OSError), socket.socket(family, socket.SOCK_DGRAM) as probe:
        # Connecting a datagram socket sends nothing: it only asks for the route.
        probe.connect((host, 9))
        return str(probe.getsockname()[0])
    return None


def _hosts_v4() -> list[str]:
    return [host for _, host in _named_hosts_v4()]


def _named_hosts_v4() -> list[tuple[str, str]]:
    hosts = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        for _, name in socket.if_nameindex():
            request = struct.pack(f"{_REQUEST_BYTES}s", name.encode()[:15])
            try:
                (flags,) = struct.unpack_from("@H", fcntl.ioctl(probe, _SIOCGIFFLAGS, request), 16)
                if flags & _IFF_UP and not flags & _IFF_LOOPBACK:
                    host = socket.inet_ntoa(fcntl.ioctl(probe, _SIOCGIFADDR, request)[20:24])
                    hosts.append((name, host))
            except OSError:
                # An interface without an IPv4 address, or one that has just gone.
                continue
    return hosts


def _hosts_v6() -> list[str]:
    try:
        lines = _IF_INET6.read_text().splitlines()
    except OSError:
        return []
    fields = (line.split() for line in lines)
    found = (line for line in fields if len(line) == 6 and line[3] == _GLOBAL_SCOPE)
    return [str(ipaddress.IPv6Address(int(line[0], 16))) for line in found]
