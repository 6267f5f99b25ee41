"""The trace of a camera's phase: where it is, and that it stays in its place."""

from hypothesis import given
from hypothesis import strategies as st

from capture_app.tui.rig_record import phases_at
from capture_app.tui.widgets.plots import PhaseAxis, band_fraction, strip_rows, times_of

AXIS = PhaseAxis.of([100_000, 0], 33_333_333)


def rows(errors: list[int | None], height: int = 3) -> list[str]:
    drawn = strip_rows(errors, AXIS, width=len(errors), height=height, dimmed=False)
    return [row.plain for row in drawn]


def test_the_axis_has_the_tolerance_as_its_band_and_half_a_period_as_its_ends() -> None:
    assert str(AXIS) == "band ±100 µs · ends ±17 ms"
    assert AXIS.labels(3) == ["┐+17ms", "┤±100µs", "┘−17ms"]


def test_what_is_late_is_above_the_band_and_what_is_within_tolerance_in_it() -> None:
    assert rows([3_000_000, 3_000_000]) == ["──", "┈┈", "  "]
    assert rows([-3_000_000, -3_000_000]) == ["  ", "┈┈", "──"]
    assert rows([99_000, 0, -99_000]) == ["   ", "▔─▁", "   "]
    assert rows([None, None]) == ["  ", "┈┈", "  "]


def test_a_phase_that_goes_around_is_not_drawn_through_the_middle() -> None:
    assert rows([16_000_000, -16_000_000]) == ["▔ ", "┈┈", " ▁"]


@given(st.floats(-2e7, 2e7), st.floats(-2e7, 2e7), st.sampled_from([1, 3, 5, 7, 9]))
def test_a_later_phase_is_never_drawn_lower(one: float, other: float, height: int) -> None:
    band = band_fraction(height)
    low, high = sorted((one, other))
    assert 0 <= AXIS.place(low, band) <= AXIS.place(high, band) <= 1
    inside = abs(one) <= AXIS.tolerance_ns
    assert inside == (abs(AXIS.place(one, band) - 0.5) <= band / 2 + 1e-12) or abs(abs(one) - 1e5) < 1


def test_a_scale_is_linear_in_its_band() -> None:
    axis = PhaseAxis(tolerance_ns=10, limit_ns=1000)
    assert [axis.place(v, 0.5) for v in (-2000, -10, -5, 0, 5, 10, 100, 1000)] == [
        0,
        0.25,
        0.375,
        0.5,
        0.625,
        0.75,
        0.875,
        1,
    ]


@given(st.floats(0, 1e6), st.floats(0, 5))
def test_the_trace_of_a_moment_does_not_move_until_the_strip_does(now: float, later: float) -> None:
    before, after = times_of(30, now), times_of(30, now + later)
    common = set(before) & set(after)
    assert len(common) >= 30 - later - 1
    assert now - 1.0 - 1e-6 <= before[-1] <= now


def test_a_phase_holds_until_the_next_is_told() -> None:
    assert phases_at([(1.0, 5), (2.0, None), (3.0, 7)], [0.5, 1.0, 1.9, 2.5, 9.0]) == [None, 5, 5, None, 7]
