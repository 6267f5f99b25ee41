"""Addresses as users type them."""

import pytest

from capture_app.net.address import DEFAULT_PORT, Address, parse_address


@pytest.mark.parametrize(
    ("text", "host", "port"),
    [
        ("leader.local:5000", "leader.local", 5000),
        ("10.0.0.7", "10.0.0.7", DEFAULT_PORT),
        ("[fe80::1%eth0]:5000", "fe80::1%eth0", 5000),
        ("[::1]", "::1", DEFAULT_PORT),
    ],
)
def test_what_is_an_address(text: str, host: str, port: int) -> None:
    assert parse_address(text) == Address(host, port)


@pytest.mark.parametrize("text", ["", ":5000", "host:", "host:port", "host:0", "host:65536", "::1", "a b:1"])
def test_what_is_none(text: str) -> None:
    with pytest.raises(ValueError, match=r".+"):
        parse_address(text)


@pytest.mark.parametrize("address", [Address("::1", 5000), Address("10.0.0.7", 5000)])
def test_an_address_reads_back_as_it_is_written(address: Address) -> None:
    assert parse_address(str(address)) == address
