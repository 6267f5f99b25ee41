"""What a pump owes its engine, on a loop and a socket that only take notes."""

import asyncio
import socket
from collections.abc import Callable
from typing import Any

import pytest

from capture_app.common import system
from capture_app.common.clock import HostClock
from capture_app.common.errors import NetworkError
from capture_app.net import udp
from capture_app.net.udp import Pump, client_socket

PEER = ("10.0.0.1", 47010)
S = 1_000_000_000


class Timer:
    """A timer of the loop."""

    def __init__(self, after_s: float, call: Callable[[], None]) -> None:
        self.after_s, self.call, self.is_cancelled = after_s, call, False

    def cancel(self) -> None:
        self.is_cancelled = True


class Host:
    """A machine's loop, clock and socket, and the engine on it."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now_ns, self.happened = 100 * S, list[Any]()
        self.due_ns: int | None = None
        self.outbox: list[tuple[bytes, tuple[str, int]]] = []
        self.timers: list[Timer] = []
        self.at_flush: Callable[[], object] = lambda: None
        self.receive: Callable[..., None] = pytest.fail
        monkeypatch.setattr(asyncio, "get_running_loop", lambda: self)
        monkeypatch.setattr(system, "receive_datagrams", self._receive_datagrams)
        clock: Any = HostClock()
        monkeypatch.setattr(HostClock, "now_ns", lambda _: self.now_ns)
        engine: Any = self
        self.pump = Pump(engine, clock, self._flush)

    def _receive_datagrams(self, _: Any, __: int, received: Any, ___: Any, *, at_once: int) -> Any:
        self.receive = received
        return lambda: self.happened.append("ended receiving")

    def _flush(self) -> None:
        self.happened.append("flushed")
        self.at_flush()

    # As a loop

    def call_later(self, after_s: float, call: Callable[[], None]) -> Timer:
        self.timers.append(Timer(after_s, call))
        return self.timers[-1]

    # As a socket

    def setsockopt(self, *_: int) -> None:
        raise OSError("not granted")

    def sendto(self, data: bytes, address: tuple[str, int]) -> None:
        if data == b"lost":
            raise OSError("unreachable")
        self.happened.append((data, address))

    def close(self) -> None:
        self.happened.append("closed")

    # As an engine

    def datagrams_to_send(self, now_ns: int) -> list[tuple[bytes, tuple[str, int]]]:
        assert now_ns == self.now_ns
        sent, self.outbox = self.outbox, []
        return sent

    def receive_datagram(self, data: bytes, address: tuple[str, int], _: int) -> None:
        self.happened.append(data)
        self.outbox.append((b"answer", address))

    def next_timer(self) -> int | None:
        return self.due_ns

    def handle_timer(self, now_ns: int) -> None:
        self.happened.append("timer")
        self.outbox.append((b"due", PEER))
        self.due_ns = None

    def took(self) -> list[Any]:
        """Return what happened since the last call."""
        happened, self.happened = self.happened, []
        return happened


@pytest.fixture
def host(monkeypatch: pytest.MonkeyPatch) -> Host:
    host = Host(monkeypatch)
    host.outbox, host.due_ns = [(b"lost", PEER), (b"first", PEER)], 103 * S
    sock: Any = host
    host.pump.start(sock)
    return host


def test_what_is_due_is_sent_at_once_and_a_datagram_is_answered_at_once(host: Host) -> None:
    assert host.took() == [(b"first", PEER), "flushed"]
    assert [timer.after_s for timer in host.timers] == [3.0]
    host.receive(b"question", ("10.0.0.2", 5), None, None)
    assert host.took() == [b"question", (b"answer", ("10.0.0.2", 5)), "flushed"]
    assert len(host.timers) == 1, "it is still right"


def test_a_timer_fires_once_and_one_that_is_no_longer_right_is_cancelled(host: Host) -> None:
    host.took()
    for due_ns, after_s in ((101 * S, 1.0), (99 * S, 0.0)):
        host.due_ns = due_ns
        host.pump.turn()
        assert host.timers[-2].is_cancelled
        assert host.timers[-1].after_s == after_s
    host.due_ns = None
    host.pump.turn()
    assert host.timers[-1].is_cancelled
    assert len(host.timers) == 3
    host.due_ns = 101 * S
    host.pump.turn()
    host.took()
    host.now_ns = host.due_ns + udp.LATE_NS
    host.timers[-1].call()
    assert host.took() == ["timer", (b"due", PEER), "flushed"]
    host.due_ns = 105 * S
    host.pump.turn()
    host.took()
    host.now_ns = host.due_ns + udp.LATE_NS + 1
    host.timers[-1].call()
    assert host.took() == ["flushed", "timer", (b"due", PEER), "flushed"]


def test_a_pump_that_is_closed_sends_receives_and_waits_no_more(host: Host) -> None:
    host.took()
    for _ in range(2):
        host.pump.close()
    assert host.took() == ["ended receiving", "closed"]
    assert host.timers[-1].is_cancelled
    host.outbox = [(b"late", PEER)]
    host.pump.turn()
    assert host.took() == []


def test_a_pump_that_is_closed_for_an_event_sets_no_timer(host: Host) -> None:
    host.at_flush, host.due_ns = host.pump.close, 101 * S
    host.pump.turn()
    assert [timer.is_cancelled for timer in host.timers] == [True]


def test_a_machine_without_ipv6_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    def none(*_: object) -> None:
        raise OSError(97, "Address family not supported by protocol")

    monkeypatch.setattr(socket, "socket", none)
    with pytest.raises(NetworkError, match="no AF_INET6 network here: Address family not supported"):
        client_socket(socket.AF_INET6)
