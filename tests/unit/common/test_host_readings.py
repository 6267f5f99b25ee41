"""Times of CLOCK_MONOTONIC in the host's clock, which runs on while an NTP daemon slews the former."""

import sys
import time

import pytest

from capture_app.common.host_clock import HostReadings, host_ns, read_pair

MS, S = 1_000_000, 1_000_000_000
AHEAD_NS = 7 * S
SLEWED_FROM_NS = 10 * S


def monotonic_at(host: int) -> int:
    """CLOCK_MONOTONIC, 7 s ahead and 500 ppm fast from a moment on."""
    return host + AHEAD_NS + max(0, host - SLEWED_FROM_NS) * 500 // 1_000_000


class Played:
    """Readings of a host whose clock is played."""

    def __init__(self, now_ns: int) -> None:
        self.now_ns = now_ns
        self.readings = HostReadings(lambda: (monotonic_at(self.now_ns), self.now_ns))

    def error_ns(self, at_ns: int) -> int:
        return self.readings.host_from_monotonic(monotonic_at(at_ns)) - at_ns


def test_frames_that_come_late_are_timed_through_a_slew() -> None:
    """By the difference of the clocks at its arrival, a frame 0.3 s old would be 150 us off."""
    host = Played(SLEWED_FROM_NS - 2 * S)
    errors = []
    for at_ns in range(SLEWED_FROM_NS - S, SLEWED_FROM_NS + 3 * S, 33 * MS):
        host.now_ns = at_ns + 300 * MS
        errors.append(abs(host.error_ns(at_ns)))
    assert max(errors) < 33 * MS * 500 // 1_000_000 // 4 + 2
    assert max(errors[-60:]) <= 1


def test_a_flood_of_datagrams_does_not_forget_what_a_frame_needs() -> None:
    host = Played(SLEWED_FROM_NS + S)
    for _ in range(20_000):
        host.now_ns += 50_000
        host.error_ns(host.now_ns)
    assert abs(host.error_ns(host.now_ns - 300 * MS)) <= 1


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux has CLOCK_MONOTONIC_RAW")
def test_a_pair_is_late_by_less_than_it_took_and_never_early() -> None:
    assert host_ns() == pytest.approx(time.clock_gettime_ns(time.CLOCK_MONOTONIC_RAW), abs=S)
    begun_ns = host_ns()
    _, read_ns = read_pair()
    assert begun_ns < read_ns <= host_ns()
