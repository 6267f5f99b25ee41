"""A stand-in for a phone with the Android app, on the app's two ports."""

import random
from typing import Self

from capture_app.common.clock import SimulatedClock
from capture_app.common.host_clock import host_ns
from capture_app.companions.interop.app_protocol import CALL_PORT, TIME_PORT
from capture_app.net.server import bind_datagrams
from capture_app.net.udp import Pump
from tests.unit.companions.interop.app_phone import Address, StandInPhone


class _CallPort:
    def __init__(self, phone: StandInPhone) -> None:
        self._phone = phone
        self.next_timer = phone.next_timer
        self.handle_timer = phone.handle_timer

    def receive_datagram(self, data: bytes, address: Address, now_ns: int) -> None:
        self._phone.receive_call(data, now_ns)

    def datagrams_to_send(self, now_ns: int) -> list[tuple[bytes, Address]]:
        return self._phone.calls_to_send()


class _TimePort:
    """Answers by the time of sending, as the app does, and by that of receipt."""

    def __init__(self, phone: StandInPhone) -> None:
        self._phone = phone
        self._out: list[tuple[bytes, Address]] = []

    def receive_datagram(self, data: bytes, address: Address, now_ns: int) -> None:
        self._out += self._phone.receive_time(data, address[0], now_ns)

    def datagrams_to_send(self, now_ns: int) -> list[tuple[bytes, Address]]:
        out, self._out = self._out, []
        return out

    def next_timer(self) -> None:
        return None

    def handle_timer(self, now_ns: int) -> None:
        pass


class PhoneOnSockets:
    """A stand-in phone at an address of this machine, within an `async with` block.

    All its times are those of a simulated clock: what it takes for leader time can be held against the truth.
    """

    def __init__(
        self, name: str, host: str, leader_host: str, clock: SimulatedClock, *, seed: int = 1
    ) -> None:
        self.clock = clock
        self._host = host
        self.phone = StandInPhone(
            name,
            host,
            leader_host,
            clock.now_ns(),
            random.Random(seed),
            clock,
            sensor_ppm=-clock.skew_ppm,
        )
        self._pumps: list[Pump] = []

    async def __aenter__(self) -> Self:
        for engine, port in ((_CallPort(self.phone), CALL_PORT), (_TimePort(self.phone), TIME_PORT)):
            pump = Pump(engine, self.clock, lambda: None)
            pump.start(bind_datagrams(self._host, port, hint=""))
            self._pumps.append(pump)
        return self

    async def __aexit__(self, *_: object) -> None:
        for pump in self._pumps:
            pump.close()

    @property
    def is_synced(self) -> bool:
        """Whether the app would say so."""
        return self.phone.is_synced(self.clock.now_ns())

    def error_us(self) -> float:
        """What it takes for leader time now, less what that is, where the leader's clock is this host's."""
        true_ns = host_ns()
        return (self.phone.leader_from_local(self.clock.local_from_true(true_ns)) - true_ns) / 1000
