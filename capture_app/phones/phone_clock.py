"""The clock of a phone's browser against that of the gateway's machine, by the exchanges of its page."""

from math import hypot

from capture_app.cameras.base import DeviceClock
from capture_app.phones.wire import Ping
from capture_app.sync.clock.clock_filter import ClockFilter, ClockSample
from capture_app.sync.clock.time_map import TimeMap

LEAST_SAMPLES = 300
MAPPED_EVERY_NS = 500_000_000
PENDING = 64
BROWSER_NS = 60_000.0
"""95 % of what a browser takes longer one way than the other between clock and socket; no exchange shows it.
Headless Chromium over a loopback: see docs/accuracy-measurements.md."""


class PhoneClock:
    """Estimates the gateway's monotonic time from the page's; times in ns, the page's as it tells them."""

    def __init__(self, resolution_us: float) -> None:
        """`resolution_us` is the step of the page's clock, which rounds down."""
        self._step_ns = round(resolution_us * 1000)
        self._filter = ClockFilter()
        self._pending: dict[int, tuple[int, int, int]] = {}
        self._map: TimeMap | None = None
        self._mapped_ns = 0

    @property
    def samples(self) -> int:
        """Exchanges so far."""
        return self._filter.samples

    @property
    def is_known(self) -> bool:
        """Whether enough exchanges have come to tell times by."""
        return self._map is not None

    def note_ping(self, ping: Ping, received_ns: int) -> None:
        """Take in what a ping tells of an earlier one; `received_ns` is when it came, by our clock."""
        earlier = self._pending.pop(ping.answered, None) if ping.answered is not None else None
        if earlier is None:
            return
        t0_ns, t1_ns, t2_ns = earlier
        # What came at the end of a step is told as its begin: later is safe here, earlier is not.
        t3_ns = round(ping.received_us * 1000) + self._step_ns
        self._filter.add(ClockSample(t0_ns, t1_ns, t2_ns, t3_ns))
        if self.samples >= LEAST_SAMPLES and (
            self._map is None or received_ns - self._mapped_ns >= MAPPED_EVERY_NS
        ):
            self._mapped_ns = received_ns
            self._map = self._filter.time_map(t3_ns)

    def note_pong(self, ping: Ping, received_ns: int, sent_ns: int) -> None:
        """Note that a ping is being answered."""
        self._pending[ping.number] = round(ping.now_us * 1000), received_ns, sent_ns
        if len(self._pending) > PENDING:
            del self._pending[next(iter(self._pending))]

    def gateway_ns(self, page_us: float) -> int:
        """Return the gateway's time of one of the page's, in us; the clock must be known."""
        assert self._map is not None
        return self._map.leader_from_local(round(page_us * 1000))

    def page_us(self, gateway_ns: int) -> float:
        """Return the page's time in us of one of the gateway's; the clock must be known."""
        assert self._map is not None
        return self._map.local_from_leader(gateway_ns) / 1000

    def uncertainty_ns(self, page_us: float) -> int:
        """How far off `gateway_ns` may be, in 95 of 100 cases."""
        assert self._map is not None
        known_ns = hypot(self._map.uncertainty_at(round(page_us * 1000)), BROWSER_NS)
        return min(round(known_ns), self.hard_bound_ns(page_us))

    def hard_bound_ns(self, page_us: float) -> int:
        """How far off it may be at most."""
        assert self._map is not None
        return round(self._map.hard_bound_at(round(page_us * 1000)))

    @property
    def accuracy(self) -> DeviceClock | None:
        """How well the page's clock is known at present; None while it is not."""
        if self._map is None:
            return None
        page_us = self._map.epoch_local_ns / 1000
        return DeviceClock(self.uncertainty_ns(page_us), self.hard_bound_ns(page_us))
