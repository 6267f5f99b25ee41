"""Choice of a camera pair for stereo."""

import re
from collections.abc import Mapping

import numpy as np
import pytest

from reconstruction.common.geometry import Array, View
from reconstruction.scene.pairs import MIN_MATCHES, Features, choose_stereo_pair
from tests.unit.reconstruction.conftest import HEIGHT, WIDTH, make_view

RNG = np.random.default_rng(3)
PIXELS = RNG.uniform((60, 60), (WIDTH - 20, HEIGHT - 20), (300, 2))
DESCRIPTORS = RNG.normal(0, 1, (300, 128)).astype(np.float32)
FIRST = make_view((0.0, 0.0, 0.0))


def seen(views: Mapping[str, View], count: int = 300, depth: float = 3.0) -> dict[str, Features]:
    """What each camera sees of `count` points in front of the first one."""
    points = FIRST.unproject(PIXELS, np.full(300, depth))[:count]
    return {name: features(place(view, points)) for name, view in views.items()}


def place(view: View, points: Array) -> Array:
    return view.project(points @ view.rotation.T + view.translation)


def features(at: Array) -> Features:
    return Features(at, DESCRIPTORS[: len(at)], np.ones(len(at)))


def test_a_level_baseline_is_preferred_to_a_slanted_one_of_similar_length() -> None:
    views = {"a": FIRST, "slanted": make_view((0.12, 0.12, 0.0)), "level": make_view((0.16, 0.0, 0.0))}
    assert choose_stereo_pair(views, seen(views)).cameras == ("a", "level")


def test_parallax_is_preferred_until_views_look_too_different() -> None:
    views = {"a": FIRST, "near": make_view((0.005, 0, 0)), "far": make_view((0.25, 0, 0))}
    choice = choose_stereo_pair(views, seen(views))
    assert choice.cameras is not None
    assert "far" in choice.cameras
    share, degrees = re.findall(r"[\d.]+", choice.why)
    assert float(share) == pytest.approx(80, abs=15)
    assert float(degrees) == pytest.approx(np.degrees(np.arctan(0.25 / 3)), abs=0.5)
    wide = {"a": FIRST, "some": make_view((0.3, 0, 0)), "wide": make_view((1.6, 0, 0), yaw=-20)}
    assert choose_stereo_pair(wide, seen(wide)).cameras == ("a", "some")


def test_a_camera_that_sees_little_of_the_same_is_left_out() -> None:
    views = {"a": FIRST, "b": make_view((0.25, 0, 0)), "c": make_view((0.2, 0, 0))}
    points = seen(views)
    corner = PIXELS.max(1) < 130
    points["c"] = Features(points["c"].positions[corner], DESCRIPTORS[corner], np.ones(corner.sum()))
    assert corner.sum() >= MIN_MATCHES
    assert choose_stereo_pair(views, points).cameras == ("a", "b")


@pytest.mark.parametrize(("count", "cameras"), [(MIN_MATCHES - 1, None), (MIN_MATCHES, ("a", "b"))])
def test_too_few_points_in_common_are_said(count: int, cameras: tuple[str, str] | None) -> None:
    views = {"a": FIRST, "b": make_view((0.2, 0, 0))}
    choice = choose_stereo_pair(views, seen(views, count))
    assert choice.cameras == cameras
    assert choice.why.startswith("no two cameras have 25 points at rest") == (cameras is None)


def test_a_calibration_that_does_not_fit_the_pictures_is_said() -> None:
    views = {"a": FIRST, "b": make_view((0.2, 0, 0))}
    points = seen(views)
    points["b"] = features(points["b"].positions + np.array([0.0, 4.0]))
    choice = choose_stereo_pair(views, points)
    assert choice.cameras is None
    assert choice.why == (
        "a and b have 300 points at rest in common, but only 0 within 3 pixels of their epipolar lines: "
        "the calibration does not fit the pictures"
    )
    points["b"] = features(points["b"].positions - np.array([0.0, 2.0]))
    assert choose_stereo_pair(views, points).cameras == ("a", "b")


def test_pairs_that_cannot_be_rectified_are_left_out_and_named() -> None:
    views = {"a": FIRST, "behind": make_view((0, 0, -1.0)), "same": FIRST, "b": make_view((0.2, 0, 0))}
    choice = choose_stereo_pair(views, seen(views))
    assert choice.cameras is not None
    assert "b" in choice.cameras
    assert "one behind the other" in choice.left_out["a,behind"]
    assert "at the same place" in choice.left_out["a,same"]
    alone = choose_stereo_pair({"a": FIRST, "same": FIRST}, seen(views))
    assert alone.cameras is None
    assert "; a,same: both cameras stand at the same place" in alone.why
