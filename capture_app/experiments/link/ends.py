"""The two ends of the `link` experiment: the engine's own leader, and a client that keeps every sample."""

import asyncio
import random
import time
from collections import deque

from capture_app.camera_facts import CameraFacts, PhaseControl, TimestampSource
from capture_app.clock import NodeClock
from capture_app.errors import NetworkError
from capture_app.net.address import Address, resolve
from capture_app.net.transfer import bind
from capture_app.net.udp import Pump, ToPeer, client_socket
from capture_app.sync.clock.clock_sample import ClockSample
from capture_app.sync.rig.leader import Leader, LeaderConfig
from capture_app.sync.rig.poll_schedule import BACKLOG_NS, NEAR_NS
from capture_app.sync.wire.codec import decode, encode
from capture_app.sync.wire.messages import Goodbye, Hello, Welcome
from capture_app.sync.wire.time_messages import TimeReply, WireError, request_at, request_before_t0

HELLO_EVERY_NS = 100_000_000
JOIN_TIMEOUT_S = 10.0
NO_CAMERA = CameraFacts(
    kind="none",
    model="none",
    width=0,
    height=0,
    period_ns=33_333_333,
    phase_control=PhaseControl.NONE,
    timestamp_source=TimestampSource.UNKNOWN,
)


async def serve(host: str, port: int) -> None:
    """Answer clients as a leader does, until cancelled. Raises NetworkError."""
    datagrams, listening = bind(host, port)
    listening.close()
    leader = Leader(LeaderConfig(random.getrandbits(32), 0), random.Random())

    def drain() -> None:
        while leader.next_event() is not None:
            pass

    pump = Pump(leader, time.monotonic_ns, drain)
    pump.start(datagrams)
    try:
        await asyncio.Event().wait()
    finally:
        pump.close()


class SamplingClient:
    """A client's messages without a camera: paced time requests, every sample kept; sans-IO as the engine.

    It sends until `want` samples are there, one each `pace_ns`.
    """

    def __init__(self, rng: random.Random) -> None:
        self.samples: list[ClockSample] = []
        self.done = asyncio.Event()
        self.joined = asyncio.Event()
        self.sent = 0
        self._instance = rng.getrandbits(32)
        self._name = f"link-{self._instance:08x}"
        self._sequence = rng.getrandbits(31)
        self._client: int | None = None
        self._want, self._pace_ns, self._due_ns, self._grid_ns = 0, 0, 0, 0
        self._request: bytes | None = None
        self._outstanding: dict[int, int] = {}
        self._outbox: deque[bytes] = deque()

    def begin(self, want: int, pace_ns: int, now_ns: int) -> None:
        """Start a round: forget the samples before, and what is still on its way."""
        self.samples, self.sent = [], 0
        self._outstanding.clear()
        self.done.clear()
        self._want, self._pace_ns, self._due_ns, self._grid_ns = want, pace_ns, now_ns, now_ns

    def leave(self) -> None:
        """Say goodbye."""
        if self._client is not None:
            self._outbox.append(encode(Goodbye(self._client)))

    def receive_datagram(self, data: bytes, now_ns: int) -> None:
        """Take in a datagram that arrived at `now_ns`."""
        try:
            message = decode(data)
        except WireError:
            return
        if isinstance(message, Welcome) and message.instance == self._instance:
            self._client = message.client
            self._due_ns = now_ns
            self.joined.set()
        if not isinstance(message, TimeReply) or self.done.is_set():
            return
        if self._outstanding.pop(message.sequence, None) != message.t0_ns:
            return
        sample = ClockSample(message.t0_ns, message.t1_ns, message.t2_ns, now_ns)
        self.samples.append(sample)
        # As the engine's client does it.
        if sample.round_trip_ns < NEAR_NS and self._due_ns <= now_ns + self._pace_ns:
            self._prepare(now_ns)
        if len(self.samples) >= self._want:
            self.done.set()

    def handle_timer(self, now_ns: int) -> None:
        """Do what is due."""
        if now_ns < self._due_ns:
            return
        if self._client is None:
            self._due_ns = now_ns + HELLO_EVERY_NS
            self._outbox.append(encode(Hello(self._name, self._instance, NO_CAMERA)))
        elif self._want and not self.done.is_set():
            self._prepare(now_ns)

    def _prepare(self, now_ns: int) -> None:
        assert self._client is not None
        self._grid_ns = max(self._grid_ns + self._pace_ns, now_ns - BACKLOG_NS)
        self._due_ns = max(self._grid_ns, now_ns + self._pace_ns // 2)
        self._sequence = (self._sequence + 1) & 0xFFFFFFFF
        self._request = request_before_t0(self._client, self._sequence)

    def next_timer(self) -> int | None:
        """Local time in ns at which `handle_timer` wants to be called."""
        idle = self._client is not None and (not self._want or self.done.is_set())
        return None if idle else self._due_ns

    def datagrams_to_send(self, now_ns: int) -> list[bytes]:
        """Return the datagrams for the leader; a time request carries `now_ns`."""
        datagrams = []
        if self._request is not None:
            datagrams.append(request_at(self._request, now_ns))
            self._request = None
            self._outstanding[self._sequence] = now_ns
            self.sent += 1
        while self._outbox:
            datagrams.append(self._outbox.popleft())
        return datagrams


class LinkProbe:
    """A sampling client over a real socket; `async with` joins the leader, and raises NetworkError."""

    def __init__(self, address: Address, clock: NodeClock, rng: random.Random) -> None:
        self.client = SamplingClient(rng)
        self._address = address
        self._clock = clock
        self._pump: Pump

    async def __aenter__(self) -> "LinkProbe":
        """Join the leader."""
        family, peer = await resolve(self._address)
        self._pump = Pump(ToPeer(self.client, peer), self._clock.now_ns, lambda: None)
        self.client.begin(0, 0, self._clock.now_ns())
        self._pump.start(client_socket(family))
        try:
            await asyncio.wait_for(self.client.joined.wait(), JOIN_TIMEOUT_S)
        except TimeoutError:
            self._pump.close()
            raise NetworkError(
                f"nobody answers at {self._address}",
                hint="start the other end with `capture-app experiment link --serve`",
            ) from None
        return self

    async def __aexit__(self, *_: object) -> None:
        """Leave the leader."""
        self.client.leave()
        self._pump.turn()
        self._pump.close()

    async def round(self, want: int, pace_ns: int, timeout_s: float) -> tuple[list[ClockSample], float, int]:
        """Collect `want` samples; return them, the seconds that took and the requests sent."""
        begin_ns = time.monotonic_ns()
        self.client.begin(want, pace_ns, self._clock.now_ns())
        self._pump.turn()
        try:
            await asyncio.wait_for(self.client.done.wait(), timeout_s)
        except TimeoutError:
            raise NetworkError(
                f"only {len(self.client.samples)} of {want} replies from {self._address} in {timeout_s:g} s"
            ) from None
        return self.client.samples, (time.monotonic_ns() - begin_ns) / 1e9, self.client.sent
