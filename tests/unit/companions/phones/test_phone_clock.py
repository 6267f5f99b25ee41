"""A phone's clock is found by its exchanges, and how well is told honestly."""

import random

import pytest

from benchmarks.simulated.wireless import PAPER_LINK
from capture_app.companions.phones.phone import MIN_SAMPLES, PhoneClock
from capture_app.companions.phones.wire import Ping

ZERO_NS = 77_000_000_000_000
SKEW = 30e-6
STEP_US = 100.0


def page_us(true_ns: float) -> float:
    """The page's clock, which comes in steps."""
    return ((true_ns - ZERO_NS) * (1 + SKEW) / 1000) // STEP_US * STEP_US


def exchanged(count: int, seed: int) -> tuple[PhoneClock, float]:
    """A clock after so many exchanges over WiFi as the paper measured it, and the true time then in ns."""
    clock, rng = PhoneClock(STEP_US), random.Random(seed)
    now_ns, earlier = ZERO_NS + 3e9, None
    for number in range(count):
        delays = PAPER_LINK.to_leader.draw(rng), PAPER_LINK.to_client.draw(rng)
        arrived_ns = now_ns + delays[0]
        ping = Ping(number, None if earlier is None else number - 1, earlier or 0.0, page_us(now_ns))
        clock.note_ping(ping, round(arrived_ns))
        clock.note_pong(ping, round(arrived_ns), round(arrived_ns))
        now_ns = arrived_ns + delays[1]
        earlier = page_us(now_ns)
        now_ns += 40e6
    return clock, now_ns


def test_it_is_not_known_by_a_few_exchanges() -> None:
    clock, _ = exchanged(MIN_SAMPLES, 1)
    assert not clock.is_known
    assert clock.accuracy is None


@pytest.mark.parametrize("seed", range(6))
def test_it_is_known_to_a_fraction_of_a_millisecond_and_says_how_well(seed: int) -> None:
    clock, now_ns = exchanged(1000, seed)
    at_us = (now_ns - ZERO_NS) * (1 + SKEW) / 1000
    error_ns = clock.gateway_ns(at_us) - now_ns
    assert abs(error_ns) <= clock.uncertainty_ns(at_us) <= clock.hard_bound_ns(at_us)
    assert abs(error_ns) < 200_000
    assert clock.page_us(round(now_ns)) == pytest.approx(at_us, abs=clock.uncertainty_ns(at_us) / 1000)


def test_an_answer_that_nobody_waits_for_is_nothing() -> None:
    clock = PhoneClock(5.0)
    clock.note_ping(Ping(7, 3, 1000.0, 2000.0), 10**9)
    assert clock.samples == 0
