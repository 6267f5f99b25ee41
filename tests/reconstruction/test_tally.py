"""Scores are medians over instants: none decides alone, and few give no interval."""

import pytest

from reconstruction.scores.study_result import DepthScores
from reconstruction.scores.tally import Measurements, Tally


def instants(*shares: tuple[int, int]) -> Tally:
    return Tally(Measurements(shares={"mover_coverage": share}) for share in shares)


def test_an_instant_with_much_motion_does_not_outvote_the_others() -> None:
    tally = instants((7080, 10000), (0, 400), (70, 420), (20, 400), (0, 410))
    assert tally.value("mover_coverage") == pytest.approx(0.05)
    found = tally.scores(DepthScores).intervals["mover_coverage"]
    assert found.low < 0.05 < found.high


def test_there_is_no_interval_from_instants_that_show_nothing() -> None:
    alone = instants((7080, 10000), (0, 0), (3, 12), (0, 0), (0, 5))
    assert alone.value("mover_coverage") == pytest.approx(0.708)
    assert alone.scores(DepthScores).intervals == {}
    assert instants((0, 0)).value("mover_coverage") is None
