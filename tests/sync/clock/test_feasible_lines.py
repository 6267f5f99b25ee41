"""The polygon of lines that a set of bounds leaves possible."""

from hypothesis import given
from hypothesis import strategies as st

from capture_app.sync.clock.feasible_lines import FeasibleLines


def box() -> FeasibleLines:
    return FeasibleLines(lowest=-10.0, highest=10.0, steepest=1.0)


def test_bounds_at_two_times_leave_a_range_in_between_and_a_wider_one_outside() -> None:
    lines = box()
    for t in (-4.0, 4.0):
        assert lines.bound_below(t, -1.0)
        assert lines.bound_above(t, 1.0)
    assert lines.value_range_at(0.0) == (-1.0, 1.0)
    assert lines.value_range_at(8.0) == (-2.0, 2.0)
    assert lines.slope_range() == (-0.25, 0.25)


def test_bounds_that_contradict_each_other_leave_nothing() -> None:
    lines = box()
    assert lines.bound_below(0.0, 2.0)
    assert not lines.bound_above(0.0, 1.0)
    assert lines.empty
    assert not lines.bound_above(0.0, 5.0)


coordinate = st.floats(-100, 100)


@given(st.floats(-9, 9), st.floats(-1, 1), st.lists(st.tuples(coordinate, st.floats(0, 50), st.booleans())))
def test_a_line_that_respects_every_bound_stays_inside(
    value: float, slope: float, bounds: list[tuple[float, float, bool]]
) -> None:
    lines = box()
    for t, room, above in bounds:
        at = value + slope * t
        assert lines.bound_above(t, at + room + 1e-6) if above else lines.bound_below(t, at - room - 1e-6)
    for t in (-50.0, 0.0, 50.0):
        low, high = lines.value_range_at(t)
        assert low - 1e-3 <= value + slope * t <= high + 1e-3
