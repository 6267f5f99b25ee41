"""What a leader's port owes its streams, without a socket and in virtual time."""

import asyncio
import errno
import socket
from typing import Any

import pytest

from capture_app.common.errors import BadInputError, NetworkError
from capture_app.common.pairing_codes import Role
from capture_app.net import server as module
from capture_app.net.server import KNOWN_EVERY_S, TransferServer, bind_port
from capture_app.trust.trust import Peer
from tests.unit.net.echoes import Ping
from tests.unit.net.test_channel_duty import Wire, with_header

CAMERA, OPERATOR = (Peer(role, roles=frozenset({role})) for role in (Role.CAMERA, Role.OPERATOR))


class Sealed:
    """A leader's trust, which identifies the peer of each stream in turn."""

    def __init__(self, *peers: Peer) -> None:
        self.peers, self.known, self.is_damaged = [*peers], {peer.pin: peer for peer in peers}, False

    def server_context(self) -> None:
        return None

    def peer(self, _: bytes | None) -> Peer:
        return self.peers.pop(0)

    def peer_of(self, pin: str) -> Peer:
        if self.is_damaged:
            raise BadInputError("machines.json is damaged")
        return self.known.get(pin, Peer(pin))


class Port:
    """A port whose streams are served until the test says."""

    def __init__(self, *peers: Peer, **limits: Any) -> None:
        self.trust, self.served, self.ends = Sealed(*peers), list[Any](), asyncio.Event()
        self.fails: BaseException | None = None
        trust: Any = self.trust
        self.server = TransferServer[Ping](Ping, self._serve, trust=trust, **limits)

    async def _serve(self, channel: Any) -> None:
        self.served.append(channel.who)
        await self.ends.wait()
        if self.fails is not None:
            raise self.fails

    async def accept(self) -> tuple[Wire, "asyncio.Task[None]"]:
        """Let a stream come, and wait until it is served or refused."""
        arriving, wire = asyncio.StreamReader(), Wire()
        arriving.feed_data(with_header(b"{}"))
        writer: Any = wire
        task = asyncio.create_task(self.server._accept(arriving, writer))
        await asyncio.sleep(0.1)
        return wire, task


@pytest.mark.virtual
@pytest.mark.parametrize(
    "error", [None, NetworkError("broke off"), OSError("lost"), asyncio.CancelledError()]
)
async def test_a_stream_is_served_closed_and_forgotten_however_it_ends(error: BaseException | None) -> None:
    port = Port(CAMERA)
    port.fails = error
    wire, task = await port.accept()
    assert (port.served, [*port.server._open.values()]) == ([CAMERA], [CAMERA])
    assert port.server._tasks == {task}
    assert wire.options == [(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)]
    port.ends.set()
    await task
    assert wire.is_closed
    assert (port.server._open, port.server._tasks) == ({}, set())


@pytest.mark.virtual
async def test_a_stream_too_many_is_broken_off_unserved(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "RESERVED", 1)
    port = Port(OPERATOR, CAMERA, max_streams=1)
    first, serving = await port.accept()
    for channel in port.server._open:
        channel.is_known = True
    beyond, refused = await port.accept()
    assert (port.served, beyond.is_aborted, refused.done()) == ([OPERATOR], True, True)
    assert not port.trust.peers, "it was identified, as it might have been an operator's"
    port.server._max_streams = 0
    too_many, refused = await port.accept()
    assert (port.served, too_many.is_aborted, refused.done()) == ([OPERATOR], True, True)
    assert not first.is_aborted
    assert [*port.server._open.values()] == [OPERATOR]
    port.ends.set()
    await serving


@pytest.mark.virtual
async def test_a_machine_that_is_removed_or_may_something_else_loses_its_streams() -> None:
    unknown, other = Peer(), Peer("other", roles=CAMERA.roles)
    port = Port(unknown, CAMERA, other, OPERATOR)
    wires = [(await port.accept())[0] for _ in range(4)]
    watching = asyncio.create_task(port.server._watch_known())

    async def aborted() -> list[bool]:
        await asyncio.sleep(KNOWN_EVERY_S + 0.1)
        return [wire.is_aborted for wire in wires]

    assert await aborted() == [False] * 4
    del port.trust.known["other"]
    port.trust.is_damaged = True
    assert await aborted() == [False] * 4, "its file is read again"
    port.trust.is_damaged = False
    assert await aborted() == [False, False, True, False]
    port.trust.known[OPERATOR.pin] = Peer(OPERATOR.pin, roles=frozenset({Role.CAMERA, Role.OPERATOR}))
    assert await aborted() == [False, False, True, True]
    watching.cancel()
    port.ends.set()


class Bound:
    """A socket that is bound."""

    def __init__(self, port: int) -> None:
        self.port, self.is_closed = port, False

    def getsockname(self) -> tuple[str, int]:
        return "", self.port

    def close(self) -> None:
        self.is_closed = True


class Ports:
    """A host's ports, of which some are in use for streams or datagrams."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, *, streams: set[int], datagrams: set[int]) -> None:
        self.used = {socket.SOCK_STREAM: streams, socket.SOCK_DGRAM: datagrams}
        self.bound: list[Bound] = []
        self.free = iter(range(50_000, 60_000))
        monkeypatch.setattr(module, "_bound", self._bound)

    def _bound(self, host: str, port: int, kind: socket.SocketKind) -> Bound:
        port = port or next(self.free)
        if port in self.used[kind]:
            raise OSError(errno.EADDRINUSE, "Address already in use")
        self.bound.append(Bound(port))
        return self.bound[-1]


def ports_of(ports: Ports, port: int, **how: bool) -> tuple[int, int]:
    """The ports that are bound; all others are released."""
    pair: Any = bind_port("", port, **how)
    assert [sock for sock in ports.bound if not sock.is_closed] == [pair[1], pair[0]]
    return pair[0].port, pair[1].port


def test_a_port_is_one_number_for_both_kinds(monkeypatch: pytest.MonkeyPatch) -> None:
    assert ports_of(Ports(monkeypatch, streams=set(), datagrams=set()), 47010) == (47010, 47010)
    assert ports_of(Ports(monkeypatch, streams=set(), datagrams={50_000, 50_001}), 0) == (50_002, 50_002)


@pytest.mark.parametrize("kind", ["streams", "datagrams"])
def test_a_port_in_use_is_said_or_another_one_is_taken(monkeypatch: pytest.MonkeyPatch, kind: str) -> None:
    used = {"streams": set[int](), "datagrams": set[int]()} | {kind: {47010}}
    ports = Ports(monkeypatch, **used)
    with pytest.raises(NetworkError, match=r"cannot listen on .*47010: the port is in use"):
        bind_port("", 47010)
    assert all(sock.is_closed for sock in ports.bound)
    assert ports_of(Ports(monkeypatch, **used), 47010, or_free=True) == (50_000, 50_000)


def test_a_host_without_a_free_number_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    ports = Ports(monkeypatch, streams=set(), datagrams=set(range(50_000, 60_000)))
    with pytest.raises(NetworkError, match="is free for both UDP and TCP"):
        bind_port("", 0)
    assert len(ports.bound) == 20
    assert all(sock.is_closed for sock in ports.bound)
