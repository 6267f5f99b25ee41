"""Scores are medians over instants: none decides alone, and few give no interval."""

import pytest

from reconstruction.method.study_result import Interval
from reconstruction.method.tally import Measurements, Tally


def coverage(*shares: tuple[int, int]) -> Interval | None:
    """What becomes of these instants, the same in both conditions."""
    tally = Tally()
    for instant, share in enumerate(shares):
        measured = Measurements(shares={"mover_coverage": share})
        tally.add({"synced": measured, "offset": measured}, {"instant": instant})
    return tally.measures[0].synced if tally.measures else None


def test_an_instant_with_much_motion_does_not_outvote_the_others() -> None:
    found = coverage((7080, 10000), (0, 400), (70, 420), (20, 400), (0, 410))
    assert found is not None
    assert found.value == pytest.approx(0.05)
    assert found.ends[0] < 0.05 < found.ends[1]


def test_there_is_no_interval_from_instants_that_show_nothing() -> None:
    assert coverage((7080, 10000), (0, 0), (3, 12), (0, 0), (0, 5)) == Interval(value=0.708)
    assert coverage((0, 0)) is None
