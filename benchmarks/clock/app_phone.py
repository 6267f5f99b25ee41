"""A stand-in for a phone with the Android app, on the app's two ports: one end of `app_link`.

python -m benchmarks.clock.app_phone 10.77.0.2 10.77.0.1 --seconds 300 --skew-ppm 20
"""

import argparse
import asyncio
import json
import random
import time
from typing import Self

from benchmarks.clock.app_phone_stand_in import Address, StandInPhone
from capture_app.common.clock import SimulatedClock
from capture_app.interop.app_protocol import CALL_PORT, TIME_PORT
from capture_app.net.server import bind_datagrams
from capture_app.net.udp import Pump

LOOK_EVERY_S, PATIENCE_S = 0.1, 60.0


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
        true_ns = time.monotonic_ns()
        return (self.phone.leader_from_local(self.clock.local_from_true(true_ns)) - true_ns) / 1000


async def follow(host: str, leader_host: str, seconds: float, skew_ppm: float) -> dict[str, object]:
    """Join, and return the errors in us while the phone is synchronized, and how long that took in s."""
    clock = SimulatedClock(round(7200e9), skew_ppm, time.monotonic_ns())
    errors: list[float] = []
    async with PhoneOnSockets("a3f1", host, leader_host, clock) as one:
        began_s = time.monotonic()
        async with asyncio.timeout(PATIENCE_S):
            while not one.is_synced:  # noqa: ASYNC110 - the phone tells nobody
                await asyncio.sleep(LOOK_EVERY_S)
        synced_s = time.monotonic() - began_s
        lapses, first_offset_ns = 0, one.phone.offset_ns
        while time.monotonic() - began_s < synced_s + seconds:
            await asyncio.sleep(LOOK_EVERY_S)
            lapses += not one.is_synced
            errors.append(one.error_us())
        pictures = [[p.leader_ns, p.true_ns] for p in one.phone.pictures]
        told_once_us = errors[-1] + (one.phone.offset_ns - first_offset_ns) / 1000
    return {
        "synced_s": synced_s,
        "errors_us": errors,
        "lapses": lapses,
        "told_once_us": told_once_us,
        "pictures": pictures,
    }


def main() -> None:
    """Run the phone and print what it saw."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("host", help="the phone's own address")
    parser.add_argument("leader", help="the leader's, of the WiFi's hotspot")
    parser.add_argument("--seconds", type=float, required=True)
    parser.add_argument("--skew-ppm", type=float, default=20.0)
    options = parser.parse_args()
    print(json.dumps(asyncio.run(follow(options.host, options.leader, options.seconds, options.skew_ppm))))


if __name__ == "__main__":
    main()
