"""A camera's own counter in the host's clock: by reading it, and by nothing but when frames arrive."""

import random

from capture_app.cameras.arrival_clock import ArrivalClock
from capture_app.plugins.cameras.aravis.aravis_driver import LatchedClock

ORIGIN_NS, S = 5_000_000_000_000, 1_000_000_000
PPM = 40.0


def counter_at(host_ns: int) -> int:
    """A counter that began at a camera's power-on and runs fast."""
    return round((host_ns - ORIGIN_NS) * (1 + PPM * 1e-6)) + 77 * S


def test_a_counter_that_can_be_read_is_known_to_microseconds() -> None:
    rng, clock = random.Random(1), LatchedClock()
    assert clock.host_ns(0) is None
    for second in range(30):
        sent_ns = ORIGIN_NS + second * S
        latched_ns = sent_ns + round(rng.expovariate(1 / 40_000)) + 60_000
        clock.add_reading(
            sent_ns, counter_at(latched_ns), latched_ns + 60_000 + round(rng.expovariate(1 / 40_000))
        )
    for host_ns in (ORIGIN_NS + 25 * S, ORIGIN_NS + 29 * S, ORIGIN_NS + 30 * S):
        found_ns = clock.host_ns(counter_at(host_ns))
        assert found_ns is not None
        assert abs(found_ns - host_ns) < 10_000


def test_the_quickest_frames_tell_the_line_of_one_that_cannot() -> None:
    rng, clock, min_ns = random.Random(2), ArrivalClock(), 9_000_000
    assert clock.host_ns(0) is None
    errors = []
    for frame in range(3600):
        begun_ns = ORIGIN_NS + round(frame * S / 30)
        delay_ns = min_ns + round(rng.expovariate(1 / 300_000)) + (20_000_000 if rng.random() < 0.1 else 0)
        clock.add_arrival(counter_at(begun_ns), begun_ns + delay_ns)
        found_ns = clock.host_ns(counter_at(begun_ns))
        assert found_ns is not None
        errors.append(found_ns - begun_ns - min_ns)
    settled = errors[300:]
    assert max(map(abs, settled)) < 60_000, "late by the least delay, and by nothing else"


def test_a_counter_that_was_set_begins_anew() -> None:
    clock = ArrivalClock()
    for frame in range(90):
        clock.add_arrival(77 * S + frame * S // 30, ORIGIN_NS + frame * S // 30)
    for frame in range(90):
        clock.add_arrival(frame * S // 30, ORIGIN_NS + (90 + frame) * S // 30)
    assert clock.host_ns(2 * S) == ORIGIN_NS + 5 * S
