"""What a host's own kernel tells of its clock being slewed."""

from collections.abc import Callable

import pytest

from capture_app.common.clock import EVERY_NS, HostRate

S = 1_000_000_000


def host(applied_ppm: list[float], steady_ppm: float | None) -> tuple[HostRate, Callable[[], float | None]]:
    """A host whose kernel applies these corrections, one after the other; what it measures of each."""
    elapsed_ns = [0, 0]

    class Host(HostRate):
        @staticmethod
        def read_clocks() -> tuple[int, int]:
            return elapsed_ns[0], elapsed_ns[1]

        @staticmethod
        def steady_correction_ppm() -> float | None:
            return steady_ppm

    rate = Host()

    def measure() -> float | None:
        ppm = applied_ppm.pop(0)
        elapsed_ns[1] += EVERY_NS
        elapsed_ns[0] += round(EVERY_NS * (1.0 + ppm * 1e-6))
        return rate.slewing_ppm(elapsed_ns[1])

    rate.slewing_ppm(0)
    return rate, measure


def test_a_steady_correction_of_a_crystal_is_no_slewing() -> None:
    _, measure = host([38.0, 38.0, 38.4], 38.0)
    assert [measure() for _ in range(3)] == [0.0, 0.0, 0.0]


def test_a_time_that_is_being_corrected_is_seen_beyond_the_steady_correction() -> None:
    _, measure = host([38.0, 538.0, 38.0, -462.0], 38.0)
    assert [measure() for _ in range(4)] == [
        0.0,
        pytest.approx(500.0, abs=1.0),
        0.0,
        pytest.approx(-500, abs=1),
    ]


def test_a_correction_that_is_called_steady_and_is_too_large_for_a_crystal_is_slewing_too() -> None:
    _, measure = host([2000.0], 2000.0)
    assert measure() == pytest.approx(1900.0, abs=1.0), "chrony slews by the frequency itself"


def test_a_host_that_does_not_say_its_correction_says_nothing() -> None:
    _, measure = host([500.0, 500.0], None)
    assert [measure(), measure()] == [None, None]


def test_between_two_measurements_the_last_one_counts() -> None:
    rate, measure = host([538.0, 38.0], 38.0)
    first = measure()
    assert first is not None
    assert rate.slewing_ppm(EVERY_NS + 1) == first
    assert measure() == 0.0


def test_this_host_tells_what_it_can() -> None:
    clocks, steady_ppm = HostRate.read_clocks(), HostRate.steady_correction_ppm()
    assert clocks is None or all(reading > 0 for reading in clocks)
    assert steady_ppm is None or abs(steady_ppm) < 100_000
