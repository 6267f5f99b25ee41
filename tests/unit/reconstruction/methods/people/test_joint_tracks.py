"""Where a joint was between two frames."""

import numpy as np
import pytest

from reconstruction.methods.people.joint_tracks import Track, interpolate

TIMES = np.arange(10) / 10


def track(missing: tuple[int, ...] = ()) -> Track:
    """Return a joint that moves along a cubic curve, and is not seen in some frames."""
    pixels = np.stack([100 * TIMES**3, 50 * TIMES], axis=1)[:, None]
    pixels[list(missing)] = np.nan
    return Track(0, TIMES[:, None], pixels, np.where(np.isnan(pixels[..., 0]), 0.0, 1.0))


def at(time: float, missing: tuple[int, ...] = (), **options: bool) -> list[float]:
    return interpolate(track(missing), np.array([time]), 0.1, **options).pixels[0, 0].tolist()


def test_a_cubic_motion_is_interpolated_exactly() -> None:
    assert at(0.45) == pytest.approx([100 * 0.45**3, 22.5])


def test_a_frame_is_taken_as_it_is_at_its_own_time() -> None:
    found = interpolate(track(), np.array([0.4]), 0.1)
    assert found.pixels[0, 0].tolist() == pytest.approx([6.4, 20])
    assert (found.noise[0, 0], found.bend[0, 0], found.moved[0, 0]) == pytest.approx((1, 0, 0), abs=1e-9)


def test_one_missing_frame_is_bridged_and_two_are_a_gap() -> None:
    assert at(0.42, (4,)) == pytest.approx([100 * 0.42**3, 21], abs=0.6)
    assert np.isnan(at(0.42, (4, 5))).all()


def test_the_nearest_frame_is_not_moved() -> None:
    assert at(0.44, nearest=True) == pytest.approx([6.4, 20])


def test_the_ends_are_extended_by_a_quarter_of_a_period_and_no_more() -> None:
    assert at(0.92)[1] == pytest.approx(46)
    assert np.isnan(at(0.93)).all()
    assert np.isnan(at(-0.03)).all()


def test_a_single_frame_counts_at_its_own_time_alone() -> None:
    alone = tuple(range(1, 10))
    assert at(0.0, alone) == [0.0, 0.0]
    assert np.isnan(at(0.01, alone)).all()
