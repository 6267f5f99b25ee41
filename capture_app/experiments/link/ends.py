"""The two ends of the `link` experiment: the engine's own leader, and its client without a camera."""

import asyncio
import random
import time
from dataclasses import dataclass

from capture_app.clock import HostClock, NodeClock
from capture_app.errors import NetworkError
from capture_app.net.address import Address, resolve
from capture_app.net.server import bind_port
from capture_app.net.udp import Pump, SinglePeerEngine, client_socket
from capture_app.sync.clock.clock_filter import ClockSample
from capture_app.sync.clock.time_map import TimeMap
from capture_app.sync.rig.events import Joined, JoinRefused, LeaderLost
from capture_app.sync.rig.leader import Leader, LeaderConfig
from capture_app.sync.rig.time_client import TimeClient
from capture_app.sync.timekeeping.poll_schedule import SteadySchedule
from capture_app.sync.timekeeping.timekeeper import Timekeeper

JOIN_TIMEOUT_S = 10.0


async def serve(host: str, port: int) -> None:
    """Answer clients as a leader does, until cancelled. Raises NetworkError."""
    datagrams, listening = bind_port(host, port)
    listening.close()
    leader = Leader(LeaderConfig(random.getrandbits(32), 0), random.Random())

    def drain() -> None:
        while leader.next_event() is not None:
            pass

    pump = Pump(leader, HostClock(), drain)
    pump.start(datagrams)
    try:
        await asyncio.Event().wait()
    finally:
        pump.close()


@dataclass(frozen=True, slots=True)
class Synchronization:
    """What a client has of its leader's clock once it has seen so many samples.

    `time_map` is the engine's own estimate at that moment, `seconds` the time since the client had joined.
    """

    samples: list[ClockSample]
    time_map: TimeMap
    seconds: float
    requests: int


class LinkClient:
    """A node without a camera, from joining on until it has enough samples; `client` is the engine's own."""

    def __init__(self, rng: random.Random, messages: int, pace_ns: int | None = None) -> None:
        """Without `pace_ns` it asks as the engine does by itself."""
        self.joined = asyncio.Event()
        self.done = asyncio.Event()
        self.problem = ""
        self.samples: list[ClockSample] = []
        self.result: Synchronization | None = None
        schedule = SteadySchedule()
        if pace_ns is not None:
            schedule = SteadySchedule(first_pace_ns=pace_ns, easing_paces_ns=(), pace_ns=pace_ns)
        instance = rng.getrandbits(32)
        self.timekeeper = Timekeeper(rng.getrandbits(31), schedule, on_sample=self.samples.append)
        self.client = TimeClient(f"link-{instance:08x}", instance, self.timekeeper)
        self._messages = messages
        self._joined_s = 0.0

    def note_events(self, now_s: float) -> None:
        """Look at what has happened; `now_s` is any clock that runs evenly. Call it after each step."""
        while (event := self.client.next_event()) is not None:
            match event:
                case Joined():
                    self._joined_s = now_s
                    self.joined.set()
                case JoinRefused():
                    self.problem = event.reason
                case LeaderLost():
                    self.problem = event.reason
                    self.done.set()
                case _:
                    pass
        time_map = self.timekeeper.time_map
        if len(self.samples) < self._messages or not self.timekeeper.synced or time_map is None:
            return
        if self.result is None:
            requests, seconds = self.timekeeper.requests, now_s - self._joined_s
            self.result = Synchronization(list(self.samples), time_map, seconds, requests)
            self.done.set()


async def synchronize(
    address: Address,
    clock: NodeClock,
    link: LinkClient,
    *,
    timeout_s: float,
    join_timeout_s: float = JOIN_TIMEOUT_S,
) -> Synchronization:
    """Join the leader at an address, take the samples, and leave. Raises NetworkError."""
    family, peer = await resolve(address)
    pump = Pump(SinglePeerEngine(link.client, peer), clock, lambda: link.note_events(time.monotonic()))
    pump.start(client_socket(family))
    try:
        await asyncio.wait_for(link.joined.wait(), join_timeout_s)
        await asyncio.wait_for(link.done.wait(), timeout_s)
    except TimeoutError:
        if link.joined.is_set():
            raise NetworkError(
                f"only {len(link.samples)} replies from {address} in {timeout_s:g} s"
            ) from None
        if link.problem:
            raise NetworkError(f"{address} refused this client: {link.problem}") from None
        raise NetworkError(
            f"nobody answers at {address}",
            hint="start the other end with `capture-app experiment link --serve`",
        ) from None
    finally:
        link.client.leave()
        pump.turn()
        pump.close()
    if link.result is None:
        raise NetworkError(f"the leader at {address} was lost: {link.problem}")
    return link.result
