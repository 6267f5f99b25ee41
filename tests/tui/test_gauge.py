"""The gauge of a stream's distance from the grid."""

from hypothesis import given
from hypothesis import strategies as st

from capture_app.tui.widgets.nodes import gauge


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
