"""Numbers as people read them."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from capture_app.tui.formats import clock_offset, gauge, short_time


@pytest.mark.parametrize(
    ("ns", "text"),
    [
        (None, "–"),
        (0, "0 ns"),
        (850, "850 ns"),
        (1_234, "1.2 µs"),
        (12_400, "12 µs"),
        (999_499, "999 µs"),
        (999_600, "1.0 ms"),
        (-3_400_000, "-3.4 ms"),
        (2_100_000_000, "2.1 s"),
    ],
)
def test_short_times(ns: int | None, text: str) -> None:
    assert short_time(ns) == text


@pytest.mark.parametrize(
    ("ns", "text"),
    [
        (None, "–"),
        (45_000, "+45 µs"),
        (-12_300_000_000, "-12.3 s"),
        (15_131_204_000_000, "+4 h 12 min"),
        (-3_599_000_000_000, "-1 h 00 min"),
        (200 * 3_600_000_000_000, "+8 d 8 h"),
    ],
)
def test_offsets_of_clocks(ns: int | None, text: str) -> None:
    assert clock_offset(ns) == text


def test_the_gauge_shows_milliseconds_and_microseconds_apart() -> None:
    assert gauge(0, 21) == "··········●··········"
    assert gauge(None, 21) == "··········│··········"
    marks = [
        gauge(ns, 21).index("●") for ns in (-16_000_000, -1_000_000, -50_000, 50_000, 1_000_000, 16_000_000)
    ]
    assert marks == sorted(set(marks))


@given(st.integers(-(10**9), 10**9), st.integers(3, 40))
def test_the_gauge_never_leaves_its_line(error_ns: int, width: int) -> None:
    line = gauge(error_ns, width)
    assert len(line) == width
    assert line.count("●") == 1
