"""A stand-in for a phone with the paper's app, on the app's two ports of an address of this machine."""

import asyncio
import os
import random
from typing import Self

from capture_app.common.clock import SimulatedClock
from capture_app.common.host_clock import host_ns
from capture_app.common.tasks import end
from tests.unit.companions.softwaresync.app_phone import CALL_PORT, TIME_PORT, StandInPhone

NETWORK = f"127.{os.getpid() % 200 + 20}.{os.getpid() // 200 % 250 + 1}"
"""The app's ports are fixed: tests that run side by side have addresses of their own."""


class _Port(asyncio.DatagramProtocol):
    def __init__(self, phone: StandInPhone) -> None:
        self._phone = phone

    def connection_made(self, transport: asyncio.DatagramTransport) -> None:  # type: ignore[override]
        self._transport = transport

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:
        answer = self._phone.receive(data, self._phone.clock.now_ns())
        if answer is not None:
            # To the fixed port of the sender's machine, as the app does.
            self._transport.sendto(answer, (addr[0], TIME_PORT))


class PhoneOnSockets:
    """A stand-in phone within an `async with` block; its clock is hours off, its truth this host's clock."""

    def __init__(self, name: str, number: int, leader_host: str, skew_ppm: float) -> None:
        self.clock = SimulatedClock(number * 3_600_000_000_000, skew_ppm, host_ns())
        self.host, self._leader_host = f"{NETWORK}.{number}", leader_host
        self.phone = StandInPhone(
            name,
            "192.168.43.7",  # of another network: the leader answers to where a heartbeat came from
            self.clock.now_ns(),
            random.Random(number),
            self.clock,
            sensor_ppm=-skew_ppm,
        )

    async def __aenter__(self) -> Self:
        self._transports = []
        for port in (TIME_PORT, CALL_PORT):
            transport, _ = await asyncio.get_running_loop().create_datagram_endpoint(
                lambda: _Port(self.phone), (self.host, port)
            )
            self._transports.append(transport)
        self._task = asyncio.create_task(self._run())
        return self

    async def __aexit__(self, *_: object) -> None:
        await end(self._task)
        for transport in self._transports:
            transport.close()

    async def _run(self) -> None:
        while True:
            if (heartbeat := self.phone.handle_timer(self.clock.now_ns())) is not None:
                self._transports[-1].sendto(heartbeat, (self._leader_host, CALL_PORT))
            await asyncio.sleep(0.005)

    def time_error_ns(self, epoch_ns: int = 0) -> int:
        """What it takes for leader time now, less the epoch and this host's clock, as a leader here has."""
        true_ns = host_ns()
        return self.phone.leader_from_local(self.clock.local_from_true(true_ns)) - epoch_ns - true_ns
