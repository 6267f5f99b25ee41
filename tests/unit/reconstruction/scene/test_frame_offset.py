"""Which frames are offset: by time, not by count, and never silently by something else."""

import pytest

from capture_app.common.errors import BadInputError
from reconstruction.scene.conditions import evenly_spaced, nearest_frame_offset

T30, T60 = 33_333_333, 16_666_667


@pytest.mark.parametrize(
    ("period", "asked_ms", "frames", "pairs"),
    [(T30, 66.0, 2, 3), (T60, 66.0, 4, 1), (T30, 33.0, 1, 4), (T60, 20.0, 1, 4), (T30, 133.0, 4, 1)],
)
def test_the_nearest_whole_frame_is_taken(period: int, asked_ms: float, frames: int, pairs: int) -> None:
    offset = nearest_frame_offset([k * period for k in range(5)], period, asked_ms)
    assert offset.frames == frames
    assert offset.actual_ns == frames * period
    assert len(offset.pairs) == pairs
    assert all(later - now == frames for now, later in offset.pairs)


def test_instants_may_be_several_periods_apart() -> None:
    offset = nearest_frame_offset([0, 3 * T30, 6 * T30, 9 * T30], T30, 200.0)
    assert (offset.frames, offset.step) == (6, 2)
    assert offset.pairs == ((0, 2), (1, 3))


def test_a_hole_in_the_burst_pairs_by_time() -> None:
    offset = nearest_frame_offset([0, T30, 3 * T30, 4 * T30], T30, 100.0)
    assert offset.pairs == ((0, 2), (1, 3))


def test_a_burst_too_short_says_what_is_possible() -> None:
    with pytest.raises(BadInputError, match=r"largest offset possible is 133 ms"):
        nearest_frame_offset([k * T30 for k in range(5)], T30, 500.0)
    with pytest.raises(BadInputError, match=r"nearest offset possible is 33\.3 ms"):
        nearest_frame_offset([k * T30 for k in range(5)], T30, 5.0)
    with pytest.raises(BadInputError, match="one instant only"):
        nearest_frame_offset([0], T30, 66.0)


def test_thinning_keeps_both_ends() -> None:
    pairs = [(k, k + 2) for k in range(30)]
    kept = evenly_spaced(pairs, 5)
    assert len(kept) == 5
    assert kept[0] == pairs[0]
    assert kept[-1] == pairs[-1]
    assert evenly_spaced(pairs, 100) == pairs
    assert evenly_spaced(pairs, 1) == [(15, 17)]
