"""Addresses as users type them."""

import ipaddress
import socket
from typing import Any

import pytest

from capture_app.common.address import DEFAULT_PORT, Address, own_hosts, parse_address, reachable_host


@pytest.mark.parametrize(
    ("text", "host", "port"),
    [
        ("leader.local:5000", "leader.local", 5000),
        ("10.0.0.7", "10.0.0.7", DEFAULT_PORT),
        ("[fe80::1%eth0]:5000", "fe80::1%eth0", 5000),
        ("[::1]", "::1", DEFAULT_PORT),
        ("leader.local.:5000", "leader.local.", 5000),
        ("führung.local", "führung.local", DEFAULT_PORT),
    ],
)
def test_what_is_an_address(text: str, host: str, port: int) -> None:
    assert parse_address(text) == Address(host, port)


@pytest.mark.parametrize(
    "text",
    ["", ":5000", "host:", "host:port", "host:0", "host:65536", "::1", "a b:1", "a..b", "x" * 230, "é" * 60],
)
def test_what_is_none(text: str) -> None:
    with pytest.raises(ValueError, match=r".+"):
        parse_address(text)


@pytest.mark.parametrize("address", [Address("::1", 5000), Address("10.0.0.7", 5000)])
def test_an_address_reads_back_as_it_is_written(address: Address) -> None:
    assert parse_address(str(address)) == address


@pytest.mark.parametrize(
    ("hosts", "told"),
    [([], "127.0.0.1"), (["10.77.1.1"], "10.77.1.1"), (["10.77.1.1", "10.77.2.1"], "10.77.1.1")],
)
def test_without_a_route_to_the_outside_an_interface_tells_where_to_join(hosts: list[str], told: str) -> None:
    nowhere: dict[str, Any] = {"find_source": lambda *_: None, "find_own": lambda _: hosts}
    assert reachable_host("0.0.0.0", socket.AF_INET, **nowhere) == told
    assert reachable_host("192.168.0.7", socket.AF_INET, **nowhere) == "192.168.0.7"


def test_own_hosts_are_addresses_that_can_be_listened_on() -> None:
    for family in (socket.AF_INET, socket.AF_INET6):
        for host in own_hosts(family):
            assert not ipaddress.ip_address(host).is_loopback
            with socket.socket(family, socket.SOCK_DGRAM) as sock:
                sock.bind((host, 0))
