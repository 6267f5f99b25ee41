"""Times of receipt from the kernel's stamps, on a host whose clocks are played."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from capture_app.common.clock import HostClock, NodeClock, SimulatedClock
from capture_app.net.udp import ReceiptTimes

MS, S = 1_000_000, 1_000_000_000
EPOCH_NS = 1_700_000_000 * S
"""CLOCK_REALTIME when CLOCK_MONOTONIC is 0."""


class Host:
    """CLOCK_MONOTONIC, and CLOCK_REALTIME that is set once; each reading takes 40 ns."""

    def __init__(self, *, set_at_ns: int = 2**62, set_by_ns: int = 0) -> None:
        self.now_ns = 5 * S
        self._set_at_ns, self._set_by_ns = set_at_ns, set_by_ns

    def monotonic(self) -> int:
        self.now_ns += 40
        return self.now_ns

    def realtime(self) -> int:
        return self.stamp_at(self.monotonic())

    def stamp_at(self, mono_ns: int) -> int:
        return EPOCH_NS + mono_ns + (self._set_by_ns if mono_ns >= self._set_at_ns else 0)

    def times(self, clock: NodeClock) -> ReceiptTimes:
        return ReceiptTimes(clock, realtime=self.realtime, monotonic=self.monotonic, host=int)


@pytest.mark.parametrize("waited_ns", [0, 50_000, 30 * MS])
@pytest.mark.parametrize("skew_ppm", [-1000.0, -50.0, 0.0, 50.0, 1000.0])
def test_a_datagram_that_waited_is_placed_where_the_node_clock_stood(waited_ns: int, skew_ppm: float) -> None:
    """Taking the age, which is in the host's seconds, off a slow clock made it early by the skew."""
    host, clock = Host(), SimulatedClock(7 * S, skew_ppm)
    times = host.times(clock)
    arrived_ns = host.now_ns + MS
    host.now_ns = arrived_ns + waited_ns
    received_ns = times.received_ns(host.stamp_at(arrived_ns))
    assert 0 <= received_ns - clock.local_from_true(arrived_ns) <= 100


@given(
    set_by_ns=st.integers(-3 * S, 3 * S),
    set_after_ns=st.integers(-10 * MS, 300 * MS),
    waits=st.lists(st.tuples(st.integers(0, 50 * MS), st.integers(0, 50 * MS)), min_size=1, max_size=4),
)
def test_a_clock_that_is_set_never_makes_a_datagram_early(
    set_by_ns: int, set_after_ns: int, waits: list[tuple[int, int]]
) -> None:
    host = Host(set_at_ns=5 * S + set_after_ns, set_by_ns=set_by_ns)
    times = host.times(HostClock())
    for before_ns, waited_ns in waits:
        arrived_ns = host.now_ns + before_ns
        host.now_ns = arrived_ns + waited_ns
        received_ns = times.received_ns(host.stamp_at(arrived_ns))
        assert arrived_ns <= received_ns <= host.now_ns
        times.queue_was_empty()


def test_a_clock_that_was_set_spoils_nothing_that_comes_later() -> None:
    host = Host(set_at_ns=5 * S + MS, set_by_ns=S)
    times = host.times(HostClock())
    host.now_ns += 2 * MS
    times.received_ns(host.stamp_at(host.now_ns))
    times.queue_was_empty()
    arrived_ns = host.now_ns + MS
    host.now_ns = arrived_ns + 20 * MS
    assert 0 <= times.received_ns(host.stamp_at(arrived_ns)) - arrived_ns <= 100


def test_without_a_stamp_it_is_now() -> None:
    host = Host()
    assert host.times(HostClock()).received_ns(None) == host.now_ns


def test_a_stamp_of_the_monotonic_clock_counts_unless_it_is_of_the_future() -> None:
    """A thread of its own stamps where the system does not."""
    host = Host()
    times = host.times(HostClock())
    arrived_ns = host.now_ns
    host.now_ns += 20 * MS
    assert times.received_ns(None, arrived_ns) == arrived_ns
    assert times.received_ns(None, host.now_ns + S) == host.now_ns
