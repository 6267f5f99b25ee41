"""Which streams a port keeps where it has too many: its rules, with streams that are only drawn."""

from typing import Any

import pytest

from capture_app.common.address import Address
from capture_app.common.pairing_codes import Role
from capture_app.net import server as module
from capture_app.net.server import TransferServer
from capture_app.trust.trust import ANYBODY, UNKNOWN_PEER, Peer, Trust
from tests.unit.net.echoes import Ping

OPERATOR, CAMERA, RELAY = (Peer(pin=str(role), roles=frozenset({role})) for role in
                           (Role.OPERATOR, Role.CAMERA, Role.RELAY))  # fmt: skip


class Stream:
    """A stream from a host, as far as it was identified."""

    def __init__(
        self, host: str, who: Peer = UNKNOWN_PEER, *, speaks: bool = True, known: bool = False
    ) -> None:
        self.peer, self.who, self.has_spoken, self.is_known = Address(host, 1), who, speaks, known
        self.is_beyond = self.is_aborted = False

    def abort(self) -> None:
        self.is_aborted = True


class Port:
    """A port of at most six streams, four of a host, and one beyond."""

    def __init__(self) -> None:
        self.server = TransferServer[Any](
            Ping,
            lambda _: pytest.fail("nothing is served"),
            max_streams=6,
            max_per_address=4,
            trust=Trust.open(),
        )
        self.open: dict[Any, Peer] = self.server._open

    def add(self, *streams: Stream) -> list[bool]:
        """Let streams come and be identified; tell of each whether it may stay, as the server does."""
        stay = []
        for stream in streams:
            part: Any = stream
            stays = self.server._admit(part) and self.server._admit_peer(part)
            if stays:
                self.open[part] = stream.who
            else:
                self.open.pop(part, None)
            stay.append(stays)
        return stay


@pytest.fixture
def port(monkeypatch: pytest.MonkeyPatch) -> Port:
    for limit, value in {"MAX_SILENT": 3, "RESERVED": 1, "MAX_STREAMS_PER_MACHINE": 2}.items():
        monkeypatch.setattr(module, limit, value)
    return Port()


def aborted(*streams: Stream) -> list[bool]:
    return [stream.is_aborted for stream in streams]


def test_a_host_with_too_many_streams_loses_its_oldest_silent_one(port: Port) -> None:
    spoken, silent, later, other = Stream("a"), Stream("a", speaks=False), Stream("a"), Stream("b")
    assert port.add(spoken, other, silent, later, Stream("a")) == [True] * 5
    assert aborted(spoken, silent, later, other) == [False] * 4
    assert port.add(Stream("a")) == [True]
    assert aborted(spoken, silent, later, other) == [False, True, False, False]
    assert port.add(Stream("a")) == [True]
    assert aborted(spoken, silent, later, other) == [True, True, False, False], "then its oldest"
    assert len(port.open) == 5


def test_a_full_port_takes_room_from_the_host_with_the_most(port: Port) -> None:
    few, many = [Stream("a"), Stream("a")], [Stream("b") for _ in range(4)]
    assert port.add(*few, *many) == [True] * 6
    new = Stream("c")
    assert port.add(new) == [True]
    assert (aborted(*few), aborted(*many)) == ([False] * 2, [True, False, False, False])
    assert not new.is_beyond


def test_silent_streams_of_all_hosts_together_are_few(port: Port) -> None:
    silent = [Stream(host, speaks=False) for host in ("a", "b", "b")]
    assert port.add(*silent, Stream("c")) == [True] * 4
    assert aborted(*silent) == [False, True, False]


def test_streams_of_joined_nodes_and_operators_make_no_room(port: Port) -> None:
    nodes = [Stream(f"n{number}", CAMERA, known=True) for number in range(2)]
    desks = [Stream(f"d{number}", OPERATOR) for number in range(4)]
    assert port.add(*nodes, *desks) == [True] * 6
    assert port.add(Stream("x")) == [False], "beyond the limits it might have been an operator's"
    desk = Stream("x", OPERATOR)
    assert port.add(desk) == [True]
    assert desk.is_beyond
    assert port.add(Stream("y", OPERATOR)) == [False], "beyond these there is no room for anybody"
    assert not any(aborted(*nodes, *desks, desk))


def test_no_relay_takes_the_room_that_is_left_for_operators(port: Port) -> None:
    assert port.add(*(Stream(f"d{number}", OPERATOR) for number in range(6))) == [True] * 6
    assert port.add(Stream("x", RELAY)) == [False]
    assert port.add(Stream("x", OPERATOR)) == [True]


def test_a_machine_has_so_many_streams_from_all_its_hosts(port: Port) -> None:
    known, spare = Stream("a", CAMERA, known=True), Stream("b", CAMERA)
    other = Stream("c", Peer(pin="other", roles=CAMERA.roles))
    assert port.add(known, other, spare) == [True] * 3
    assert aborted(known, other, spare) == [False] * 3
    new = Stream("d", CAMERA, known=True)
    assert port.add(new) == [True]
    assert aborted(known, other, spare, new) == [False, False, True, False]


def test_a_machine_whose_streams_are_all_in_use_opens_no_further_one(port: Port) -> None:
    nodes = [Stream("a", CAMERA, known=True) for _ in range(2)]
    assert port.add(*nodes) == [True] * 2
    new = Stream("b", CAMERA)
    assert port.add(new) == [False]
    assert (aborted(*nodes), new.is_aborted) == ([False] * 2, True)


def test_relays_and_operators_have_as_many_streams_as_they_open(port: Port) -> None:
    relays = [Stream(host, RELAY) for host in ("a", "b", "c", "d", "e")]
    assert port.add(*relays) == [True] * 5
    assert not any(aborted(*relays))


@pytest.mark.parametrize("is_open", [False, True], ids=["paired cameras", "an open rig"])
def test_whoever_is_neither_joined_nor_an_operator_makes_room(port: Port, is_open: bool) -> None:
    streams = [
        Stream(f"h{number}", ANYBODY if is_open else Peer(pin=f"{number}", roles=CAMERA.roles))
        for number in range(6)
    ]
    assert port.add(*streams) == [True] * 6
    assert port.add(Stream("x")) == [True]
    assert aborted(*streams) == [True, *[False] * 5]


def test_in_an_open_rig_nobody_has_the_room_that_is_left_for_operators(port: Port) -> None:
    assert port.add(*(Stream(f"h{number}", ANYBODY, known=True) for number in range(6))) == [True] * 6
    assert port.add(Stream("x", ANYBODY)) == [False]
