"""Where a joint was between two frames, and who is who in the next one."""

import numpy as np
import pytest

from reconstruction.methods.people.joint_tracks import Track, follow_in_camera, interpolate
from reconstruction.methods.people.keypoints import FrameJoints

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


def people(*places: float) -> FrameJoints:
    square = np.array([[0, 0], [40, 0], [0, 40], [40, 40]], float)
    return FrameJoints(np.array([square + np.array([x, 0]) for x in places]), np.ones((len(places), 4)))


def test_individuals_keep_their_track_in_any_order() -> None:
    frames = {0: people(0, 300), 1: people(302, 3), 2: people(6, 304)}
    left, right = follow_in_camera(frames, 3)
    assert left[0][:, 0, 0].tolist() == [0, 3, 6]
    assert right[0][:, 0, 0].tolist() == [300, 302, 304]


def test_where_it_is_open_who_is_who_tracks_end() -> None:
    frames = {0: people(0, 12), 1: people(6, 7)}
    assert len(follow_in_camera(frames, 2)) == 4


def test_names_are_believed() -> None:
    frames = {
        k: FrameJoints(people(*places).pixels, np.ones((2, 4)), names)
        for k, places, names in ((0, (0, 500), ("a", "b")), (1, (500, 0), ("a", "b")))
    }
    a, b = follow_in_camera(frames, 2)
    assert a[0][:, 0, 0].tolist() == [0, 500]
    assert b[0][:, 0, 0].tolist() == [500, 0]
