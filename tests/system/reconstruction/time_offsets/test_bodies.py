"""People before a television, and a disc that turns: what is not of the cameras' own time is no witness."""

from pathlib import Path

import pytest

from benchmarks.reconstruction.body_takes import measure, session_of


@pytest.mark.parametrize("late_ms", [0.0, 16.7])
def test_a_television_does_not_tell_the_time(tmp_path: Path, late_ms: float) -> None:
    """It filled a quarter of the picture: "33.4 ± 0.6 ms", a dropped frame, or the same instant."""
    timing = measure(session_of("large television", 1, late_ms, tmp_path))
    assert timing.late_ms is not None, timing.reason
    assert timing.uncertainty_ms is not None
    assert abs(timing.late_ms - late_ms) < timing.uncertainty_ms < 6
    assert timing.offset == bool(late_ms)
    assert not timing.change


def test_a_television_alone_is_named(tmp_path: Path) -> None:
    """The people before it are too plain to be followed."""
    timing = measure(session_of("large television", 0, 16.7, tmp_path))
    assert timing.late_ms is None
    assert timing.reason.endswith("beside the screen in the pictures of left and right")


@pytest.mark.parametrize("seed", [0, 63])
def test_a_disc_that_may_have_turned_once_more_is_certified_with_its_period(
    tmp_path: Path, seed: int
) -> None:
    """In 63, a part of the picture seems to repeat after a third of a turn."""
    timing = measure(session_of("short disc", seed, 400.0, tmp_path))
    assert timing.synchronized
    assert timing.images.span.startswith(", or a multiple of 400 ms")


def test_two_discs_fit_where_both_of_their_periods_do(tmp_path: Path) -> None:
    """The second one alone fits 200 ms early: that was said, without the offsets at which both fit."""
    timing = measure(session_of("two periods", 61, 400.0, tmp_path))
    assert timing.offset
    assert timing.late_ms == pytest.approx(400, abs=1.5)
    assert timing.images.span.startswith(", or a multiple of 1200 ms")
