"""The pump over real loopback sockets, with an engine that only takes notes."""

import asyncio
import contextlib
import socket
import time
from collections import deque
from collections.abc import AsyncIterator, Iterator
from types import SimpleNamespace
from typing import Any

import pytest

from capture_app.common.address import Address
from capture_app.common.clock import HostClock
from capture_app.common.host_clock import host_ns
from capture_app.net.udp import Pump, SinglePeerEngine, client_socket

Received = tuple[bytes, tuple[str, int], int]


class Notes:
    """An engine that sends what is put in, and notes what comes."""

    def __init__(self) -> None:
        self.received: asyncio.Queue[Received] = asyncio.Queue()
        self.outbox: deque[tuple[bytes, tuple[str, int]]] = deque()
        self.timer_ns: int | None = None
        self.ticked = asyncio.Event()
        self.ticks_ns: list[int] = []

    def receive_datagram(self, data: bytes, address: tuple[str, int], now_ns: int) -> None:
        self.received.put_nowait((data, address, now_ns))

    def datagrams_to_send(self, now_ns: int) -> list[tuple[bytes, tuple[str, int]]]:
        datagrams = list(self.outbox)
        self.outbox.clear()
        return datagrams

    def next_timer(self) -> int | None:
        return self.timer_ns

    def handle_timer(self, now_ns: int) -> None:
        if self.timer_ns is not None and now_ns >= self.timer_ns:
            self.timer_ns = None
            self.ticks_ns.append(now_ns)
            self.ticked.set()


@pytest.fixture
async def other() -> AsyncIterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        yield sock


@contextlib.contextmanager
def pumping(engine: Notes) -> Iterator[tuple[Pump, tuple[str, int]]]:
    sock = client_socket(socket.AF_INET)
    sock.bind(("127.0.0.1", 0))
    address = sock.getsockname()
    pump = Pump(engine, HostClock(), lambda: None)
    pump.start(sock)
    try:
        yield pump, address
    finally:
        pump.close()
        pump.close()


async def test_a_busy_process_does_not_delay_the_time_of_receipt(other: socket.socket) -> None:
    engine = Notes()
    with pumping(engine) as (_, address):
        # The kernel begins to stamp a moment after the first socket asks for it (net_enable_timestamp).
        for _ in range(100):
            before_ns = host_ns()
            other.sendto(b"now", address)
            time.sleep(0.02)  # noqa: ASYNC251 - the loop is blocked on purpose
            after_ns = host_ns()
            data, sender, received_ns = await engine.received.get()
            assert (data, sender) == (b"now", other.getsockname())
            assert before_ns <= received_ns
            if received_ns < after_ns:
                return
    raise AssertionError("the time of receipt was never the kernel's")


async def test_what_the_engine_wants_sent_goes_out_and_unreachable_peers_are_only_silent(
    other: socket.socket,
) -> None:
    engine = Notes()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as gone:
        gone.bind(("127.0.0.1", 0))
        nobody = gone.getsockname()
    with pumping(engine) as (pump, address):
        engine.outbox += [(b"lost", nobody), (b"lost", ("256.0.0.1", 1)), (b"hello", other.getsockname())]
        pump.turn()
        assert other.recvfrom(100) == (b"hello", address)
        other.sendto(b"still here", address)
        assert (await engine.received.get())[0] == b"still here"


async def test_the_timer_fires_not_before_it_is_due() -> None:
    engine = Notes()
    with pumping(engine) as (pump, _):
        engine.timer_ns = due_ns = host_ns() + 5_000_000
        pump.turn()
        await engine.ticked.wait()
    assert engine.ticks_ns[0] >= due_ns


async def test_a_timer_that_is_still_right_is_left_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    engine, loop = Notes(), asyncio.get_running_loop()
    engine.timer_ns = host_ns() + 60_000_000
    armed: list[float] = []
    call_later = loop.call_later
    monkeypatch.setattr(
        loop, "call_later", lambda after_s, *of: (armed.append(after_s), call_later(after_s, *of))[1]
    )
    with pumping(engine) as (pump, _):
        for _ in range(20):
            pump.turn()
        assert len(armed) == 1
        engine.timer_ns -= 40_000_000
        due_ns = engine.timer_ns
        pump.turn()
        assert len(armed) == 2
        await asyncio.wait_for(engine.ticked.wait(), 5)
        assert engine.ticks_ns[0] >= due_ns
        engine.ticked.clear()
        engine.timer_ns = due_ns
        pump.turn()
        await asyncio.wait_for(engine.ticked.wait(), 5)


async def test_a_client_listens_to_its_leader_only(other: socket.socket) -> None:
    received: list[bytes] = []
    client: Any = SimpleNamespace(
        receive_datagram=lambda data, now_ns: received.append(data),
        datagrams_to_send=lambda now_ns: [b"hello"],
        next_timer=lambda: 7,
        handle_timer=lambda now_ns: received.append(b"timer %d" % now_ns),
    )
    engine = SinglePeerEngine(client, Address("10.0.0.1", 47010))
    engine.receive_datagram(b"stranger", ("10.0.0.2", 47010), 1)
    engine.receive_datagram(b"other port", ("10.0.0.1", 47011), 2)
    engine.receive_datagram(b"leader", ("10.0.0.1", 47010), 3)
    assert engine.next_timer() == 7
    engine.handle_timer(8)
    assert received == [b"leader", b"timer 8"]
    assert engine.datagrams_to_send(4) == [(b"hello", ("10.0.0.1", 47010))]


@pytest.mark.parametrize(("late_ns", "order"), [(50_000_000, ["timer"]), (5_000_000_000, ["look", "timer"])])
def test_a_timer_that_is_very_late_has_the_node_look_first_whether_the_machine_slept(
    late_ns: int, order: list[str]
) -> None:
    """What was due in a sleep counted as dropped by the camera before the sleep was noticed."""
    happened: list[str] = []
    engine: Any = SimpleNamespace(handle_timer=lambda _: happened.append("timer"))
    clock: Any = SimpleNamespace(now_ns=lambda: late_ns, local_from_true=int)
    pump = Pump(engine, clock, lambda: happened.append("look"))
    pump._due_ns = 0
    pump._tick()
    assert happened == order
