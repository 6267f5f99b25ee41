"""Phones with the app that follow a leader in virtual time, over links that the paper measured."""

import random
from collections.abc import Callable
from typing import Any

from benchmarks.simulated.links import Channel, Direction, Link
from benchmarks.simulated.virtual_rig import Timer, VirtualTime
from benchmarks.simulated.wireless import PAPER_LINK
from capture_app.common.clock import SimulatedClock
from capture_app.companions.interop.app_leader import AppLeader
from capture_app.companions.interop.app_protocol import CALL_PORT, TIME_PORT
from tests.unit.companions.interop.app_phone import StandInPhone

S = 1_000_000_000
LEADER = "10.0.0.1"


class PhoneRig:
    """A leader, whose clock is the true time, and its phones; lost datagrams are those of the link."""

    def __init__(self, *, aligns: bool = False, seed: int = 1) -> None:
        self.time = VirtualTime()
        self.time.now_true_ns = 1000 * S
        self.leader = AppLeader(aligns=aligns)
        self.phones: list[StandInPhone] = []
        self._rng = random.Random(seed)
        self._clocks: list[SimulatedClock] = []
        self._channels: dict[str, Channel] = {}
        self._away: set[str] = set()
        self._timers = [Timer(self.time, self._turn) for _ in range(2)]
        self._phone_timers: list[Timer] = []

    @property
    def now_ns(self) -> int:
        return self.time.now_true_ns

    def add(self, name: str, skew_ppm: float, *, link: Link = PAPER_LINK, host: str = "") -> StandInPhone:
        host = host or f"10.0.0.{len(self.phones) + 2}"
        clock = SimulatedClock(round(7200e9), skew_ppm, self.now_ns)
        phone = StandInPhone(
            name,
            host,
            LEADER,
            clock.local_from_true(self.now_ns),
            random.Random(self._rng.getrandbits(64)),
            clock,
            sensor_ppm=-skew_ppm,
        )
        number = len(self.phones)
        self.phones.append(phone)
        self._clocks.append(clock)
        self._channels[host] = link.open()
        self._phone_timers.append(Timer(self.time, self._phone_turn, number))
        self._phone_timers[number].set(self.now_ns)
        return phone

    def error_ns(self, phone: StandInPhone) -> int:
        """What the phone takes for leader time now, less what it is."""
        clock = self._clocks[self.phones.index(phone)]
        return phone.leader_from_local(clock.local_from_true(self.now_ns)) - self.now_ns

    def says_synced(self, phone: StandInPhone) -> bool:
        return phone.is_synced(self._clocks[self.phones.index(phone)].local_from_true(self.now_ns))

    def take_away(self, phone: StandInPhone) -> None:
        self._away.add(self._host(phone))

    def bring_back(self, phone: StandInPhone) -> None:
        self._away.discard(self._host(phone))

    def run(self, seconds: float, done: Callable[[], bool] | None = None) -> bool:
        return self.time.run_until(self.now_ns + round(seconds * S), done)

    def turn(self) -> None:
        """Send what was ordered."""
        self._turn()

    def _host(self, phone: StandInPhone) -> str:
        return list(self._channels)[self.phones.index(phone)]

    def _turn(self) -> None:
        engines: tuple[Any, ...] = (self.leader.calls, self.leader.times)
        for number, engine in enumerate(engines):
            engine.handle_timer(self.now_ns)
            for data, (host, to) in engine.datagrams_to_send(self.now_ns):
                self._pass("to_client", host, self._at_phone, data, to)
            if (due_ns := engine.next_timer()) is not None:
                self._timers[number].set(due_ns)

    def _at_phone(self, host: str, data: bytes, port: int) -> None:
        number = list(self._channels).index(host)
        phone, local_ns = self.phones[number], self._clocks[number].local_from_true(self.now_ns)
        if port == CALL_PORT:
            phone.receive_call(data, local_ns)
        else:
            for answer, (_, to) in phone.receive_time(data, LEADER, local_ns):
                self._pass("to_leader", host, self._at_leader, answer, to)
        self._phone_turn(number)

    def _phone_turn(self, number: int) -> None:
        phone, clock = self.phones[number], self._clocks[number]
        phone.handle_timer(clock.local_from_true(self.now_ns))
        for data, (_, to) in phone.calls_to_send():
            self._pass("to_leader", self._host(phone), self._at_leader, data, to)
        self._phone_timers[number].set(clock.true_from_local(phone.next_timer()))

    def _at_leader(self, host: str, data: bytes, port: int) -> None:
        engine = self.leader.calls if port == CALL_PORT else self.leader.times
        assert port in (CALL_PORT, TIME_PORT)
        engine.receive_datagram(data, (host, 50_000), self.now_ns)
        self._turn()

    def _pass(self, way: Direction, host: str, then: Callable[..., None], data: bytes, port: int) -> None:
        if host in self._away:
            return
        for delay_ns in self._channels[host].deliveries(way, self.now_ns, self._rng):
            self.time.schedule(self.now_ns + delay_ns, then, host, data, port)
